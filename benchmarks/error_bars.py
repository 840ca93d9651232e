"""Whether errors of loads hold: scenes times steps, the errors that `--errors` states against those of a finer run.

    python benchmarks/error_bars.py [--scenes NAME ...]

The truth of a scene is its run with four times the links and an eighth of the shortest step. A row per scene, step
and load: value, stated error, true error, their ratio. At the end the shares of true errors within the stated one and
within twice of it, and the median of stated over true; goals: 90 % within the stated one, a median of at most 4. Loads
that are off by less than `EXACT` are left out of the median.
"""

import numpy as np
from study import Found, command, show

import dropper_jax as dj
from dropper_jax.report.record import record
from dropper_jax.study.load_errors import line_loads, load_errors, twice_the_links

LOADS = ("mean", "deviation", "window_maximum", "maximum")
#: Relative error that counts as none.
EXACT = 1e-6
#: Time left out at the start [s].
SKIP = 2.0


def chain(amplitude: float, period: float, duration: float) -> Found:
    """A chain of 8 links between two points in still water, one of which is moved."""
    return {
        "run": {"dt": 0.01, "duration": duration},
        "point": [
            {"name": "low", "position": [0.0, 0.0, -20.0]},
            {"name": "high", "position": [18.0, 0.0, -5.0]},
        ],
        "line": [
            {
                "name": "chain", "from": "low", "to": "high", "links": 8, "length": 25.0 / 8, "mass": 8.0 * 25.0 / 8,
                "diameter": 0.04, "axial": {"law": "rope", "EA": 5e5, "damping": 2e3},
            }
        ],
        "effects": {
            "weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.6, "cdt": 0.05},
            "end_motion": {"point": "high", "amplitude": [amplitude, 0, amplitude], "period": period, "ramp": period},
        },
        "sea": {"depth": 25.0},
    }  # fmt: skip


def pendulum(stiffness: float = 2e4) -> Found:
    """A rope of 6 links, axial stiffness [N], let go slantwise, with damping."""
    line = {"name": "rope", "from": "top", "to": "low", "links": 6, "length": 0.5, "mass": 1.0}
    return {
        "run": {"dt": 0.01, "duration": 8.0},
        "point": [
            {"name": "top", "position": [0.0, 0.0, 0.0]},
            {"name": "low", "kind": "free", "position": [1.5, 0.0, -2.6]},
        ],
        "line": [line | {"axial": {"law": "elastic", "EA": stiffness, "damping": 50.0}}],
        "effects": {"weight": {}, "linear_damping": {"b_l": 0.2}},
        "start": {"kind": "angles", "polar": [1.0] * 6},
    }


SCENES: dict[str, tuple] = {
    "driven gently": (chain(0.5, 5.0, 17.0), (0.16, 0.08, 0.04, 0.02, 0.01)),
    "driven fast": (chain(1.2, 3.0, 14.0), (0.08, 0.04, 0.02, 0.01, 0.005)),
    "driven until it snaps": (chain(1.8, 2.0, 12.0), (0.04, 0.02, 0.01, 0.005, 0.0025)),
    "driven until it snaps hard": (chain(2.2, 1.6, 10.0), (0.04, 0.02, 0.01, 0.005, 0.0025)),
    "driven until it is slack": (chain(1.0, 2.5, 13.0), (0.08, 0.04, 0.02, 0.01, 0.005)),
    "elastic pendulum": (pendulum(), (0.08, 0.04, 0.02, 0.01, 0.005)),
    "stiff pendulum": (pendulum(2e5), (0.04, 0.02, 0.01, 0.005, 0.0025)),
    "dropper-regular-wave": ("dropper-regular-wave", (0.16, 0.08, 0.04, 0.02, 0.01)),
}


def stated(scene: dj.Scene, dt: float) -> Found:
    found = load_errors(scene.with_values({"run.dt": dt}), dj.simulate, SKIP)
    return {**found["loads"][0], "not_resolved": bool(found["not_resolved"]), "chaotic": found["chaotic"]}


def truth(scene: dj.Scene, dt: float, at: float) -> dict[str, float]:
    """Loads of a run with four times the links and an eighth of the step, at the same arc length."""
    fine = twice_the_links(twice_the_links(scene)).with_values({"run.dt": dt / 8})
    (row,) = line_loads(record(dj.simulate(fine), SKIP), [{"at_m": at}])
    return {name: row[name][0] for name in LOADS}


@command(scenes=list(SCENES))
def main(args) -> None:
    held, ratios, called = [], [], []
    show("scene", "step [s]", "load", "value [N]", "stated", "true", "stated/true", "")
    for name in args.scenes:
        given, steps = SCENES[name]
        scene = dj.load_scene(given)
        scene = scene.with_values({"run.duration": min(scene.run.duration, 20.0)})
        right: dict[float, dict[str, float]] = {}
        for dt in steps:
            found = stated(scene, dt)
            at = found["at_m"]
            right.setdefault(at, truth(scene, steps[-1], at))
            for load in LOADS:
                value, error = found[load]["value"], found[load]["error"]
                true = abs(value - right[at][load])
                held.append([true <= k * error or true < EXACT * abs(value) for k in (1.0, 2.0)])
                if true > EXACT * abs(value):
                    ratios.append(error / true)
                if load == "maximum":
                    called.append((found["not_resolved"], true / abs(right[at][load])))
                cells = [f"{value:.5g}", f"{error:.2g}", f"{true:.2g}", f"{error / max(true, 1e-12):.2g}"]
                show(name, dt, load, *cells, "chaotic" if found["chaotic"] else "")
    wrongly = [share for said, share in called if said and share < 0.02]
    missed = [share for said, share in called if not said and share > 0.05]
    once, twice = np.mean(held, axis=0)
    print(f"\n{once:.0%} of {len(held)} true errors within the stated, {twice:.0%} within twice of it")
    print(f"median of stated over true: {np.median(ratios):.2g}")
    print(f"not resolved, said below a true 2 %: {len(wrongly)}; not said above 5 %: {len(missed)}; of {len(called)}")
