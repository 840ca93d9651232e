"""The paper's Table 7 measured again: all five cases from Table 6's poses, and what single conventions change in them.

    python benchmarks/table7.py [--only cases|moordyn|conventions|edulis|peaks] [--starts 10]

Needs the extra `moordyn`; takes about an hour on one core. Writes results/table7.json beside this file, from which
`python benchmarks/tables.py` makes the tables of docs/moordyn-compared.md.

`peaks`: the largest loads at steps that resolve their snaps, by two schemes at two steps each, and from `--starts`
starts whose buoy is moved by up to 1e-6 m. Where these agree within 3 % the four values must; elsewhere the motion is
chaotic, and the table gives their range. Half an hour more; writes results/table7_peaks.json.

`edulis`: tensions and motions of the Edulis longline in both codes, with errors. Both get the scene turned by 90
degrees: waves then travel in +x and MoorDyn can take its wave grid, in which buoys feel the dynamic pressure. Both
start from the static pose found here.
"""

import one_thread  # noqa: F401 - before JAX

# isort: split

from collections.abc import Callable, Iterator

import numpy as np
from moordyn_runs import GRID, STEPS, TABLE_7, case, looks_at, theirs
from study import Found, collect, command, describe, resume, spread, store, stored, versions

import dropper_jax as dj
from dropper_jax.moordyn.writing.outputs import channel_values
from dropper_jax.scene.data import point_nodes
from dropper_jax.study.load_errors import load_errors

NUMBERS = (1, 2, 3, 4, 5)
#: The paper gives no durations; its figures and texts speak of times up to 143.9 s.
SPAN, LONGEST = 150.0, 200.0  # [s]
#: Lengths of the record [s] for which means and extremes are given.
LENGTHS = (50.0, 80.0, 100.0, SPAN, LONGEST)
#: Settled part [s].
SETTLED = 50.0
#: Batches of standard errors.
BATCHES = 8
ALL, WAVES, IRREGULAR = (1, 2, 3, 4, 5), (1, 2, 3, 5), (3, 5)
#: Draught of the buoy at rest in case 4 [m].
DRAUGHT = 3.27


def of_run(run: dj.Solution, span: float) -> Found:
    """Loads at both ends up to a time: tension of the end link, and size of the force on the anchor's node."""
    kept = run.t_tension <= span
    settled = run.tension[kept & (run.t_tension > SETTLED), 0]
    found = {
        "span_s": span,
        "anchor": spread(run.tension[kept, 0]),
        "anchor_node": spread(channel_values(run, "AnchTen1")[0][kept]),
        "fairlead": spread(run.tension[kept, -1]),
    }
    if settled.size:
        found["standard_error"] = batch_error(settled, np.mean)
    return found


def ours(scene: dj.Scene, spans: tuple[float, ...]) -> Found:
    """A scene here: loads up to each time, or why there are none."""
    try:
        run = dj.simulate(scene.with_values({"run.duration": max(spans)}))
    except dj.SceneError as error:
        return {"status": str(error), "spans": []}
    if run.status not in ("ok", "energy_drift"):
        return {"status": run.status, "spans": []}
    return {"status": run.status, "spans": [of_run(run, span) for span in spans]}


def in_moordyn(number: int, ratio: float) -> Found:
    """A case in MoorDyn v2: tensions of the end segments with their sign, and as sizes."""
    rows = theirs(case(number, ratio), STEPS[ratio], SPAN, look=0.01, across=None if number == 4 else GRID)
    return {"case": number, "damping_ratio": ratio, "dt_s": STEPS[ratio], **rows.statistics()}


def changes(scene: dj.Scene) -> dict[str, tuple[tuple[int, ...], Found]]:
    """Changes of one thing by name: its cases, and values by path for the scene of one."""
    buoy, waves = scene.buoys[0], scene.sea.waves
    x, y, _ = scene.value("point.buoy.position")
    phase = np.asarray(getattr(waves, "phase", None), float)  # not a number where there are no waves
    kinetic = 0.0 if "seabed_friction" in scene.effects else 0.5
    along = 4.0 * buoy.cdt * DRAUGHT / buoy.diameter  # its side is taken as wet to the draught at rest at all times
    slack = {"line_type.chain.law": "damped_rope"}
    ratio = {"line_type.chain.damping_ratio": 1.0}
    return {
        "start at rest, not from Table 6": (ALL, {"start.kind": "static"}),
        "bed friction 0.5 added; case 2: taken away": (ALL, {"effects.seabed_friction.kinetic": kinetic}),
        "damper goes on in slack links (`damped_rope`)": (ALL, slack),
        "the same, damping ratio 1": (ALL, slack | ratio),
        "chain at the buoy's half height": (ALL, {"buoy.0.attachment": 0.5 * buoy.height}),
        "-4.43 m is the buoy's middle, chain at its base": (ALL, {"point.buoy.position": [x, y, -2.0 * 4.43]}),
        "buoy: drag along on pi D w": (ALL, {"buoy.0.cdt": along}),
        "buoy: drag along on D w": (ALL, {"buoy.0.cdt": along / np.pi}),
        "buoy: added mass along of the wet volume": (ALL, {"buoy.0.end_added_mass": "volume"}),
        "wave phases 180 degrees later": (WAVES, {"sea.waves.phase": (phase + np.pi).tolist()}),
        "wave phases 90 degrees later": (WAVES, {"sea.waves.phase": (phase + np.pi / 2).tolist()}),
        "wave phases of Table A1 with the other sign": (IRREGULAR, {"sea.waves.phase": (-phase).tolist()}),
        "chain: axial drag on D, not on pi D": (ALL, {"line_type.chain.cdt": 0.2 / np.pi}),
        "24 segments": (ALL, {"line.chain.links": 24}),
        "damping ratio 1": (ALL, ratio),
        "bed 10 times softer, damper too": (
            ALL,
            {"effects.seabed.stiffness": 3e5, "effects.seabed.damping": 3e4},
        ),
        "water above z = 0 moves as at z = 0": (WAVES, {"sea.stretching": "constant"}),
        "waves take the current's Doppler shift": ((5,), {"sea.wave_current": "doppler"}),
    }


#: Schemes of the peaks, and their two steps [s]; irregular waves and the bare start need shorter ones. Moved starts
#: take the first.
PEAK_STEPS = {"energy_momentum": (0.00125, 0.000625), "generalized_alpha": (0.001, 0.0005)}
SHORT = {"energy_momentum": (0.0003125, 0.00015625), "generalized_alpha": (0.0005, 0.00025)}
SHORTEST = {**SHORT, "generalized_alpha": (0.00025, 0.000125)}
STEPS_OF = {1: PEAK_STEPS, 2: PEAK_STEPS, 3: SHORT, 4: SHORTEST, 5: SHORT}
#: Records of the peaks [s] in a current alone, which is steady long before, and how far starts are moved [m].
STEADY, MOVED = 30.0, 1e-6


def peak_cases(starts: int) -> Iterator[Found]:
    """Cases by scheme and step, then with moved starts."""
    draws = np.random.default_rng(7).uniform(-MOVED, MOVED, starts)
    for number in NUMBERS:
        own = [
            {"case": number, "scheme": scheme, "dt_s": dt} for scheme, steps in STEPS_OF[number].items() for dt in steps
        ]
        yield from ({**one, "moved_m": 0.0} for one in own)
        yield from ({**own[0], "moved_m": float(moved)} for moved in draws)


def peak_loads(**values) -> Found:
    """Tensions [N] of the links at both ends over the first 150 s, by the values of `peak_cases`."""
    scene = case(values["case"])
    x, *rest = scene.value("point.buoy.position")
    changes = {
        "run.duration": STEADY if values["case"] == 4 else SPAN,
        "run.integrator": values["scheme"],
        "run.dt": values["dt_s"],
        "point.buoy.position": [x + values["moved_m"], *rest],
    }
    run = dj.simulate(scene.with_values(changes))
    return {"status": run.status, "anchor": spread(run.tension[:, 0]), "fairlead": spread(run.tension[:, -1])}


#: Edulis: start of the compared part [s], time between looks at MoorDyn [s], and its steps [s]; the second one tells
#: the first one's error.
SKIP, LOOK, EDULIS_STEPS = 30.0, 0.03, (0.0005, 0.00025)
#: Lines whose ends are compared, whether it is the last end, and points that are followed.
ENDS = (
    ("west leg at the Danforth anchor", "west-leg", False),
    ("west leg at the buoy", "west-leg", True),
    ("backbone at the west buoy", "backbone-1", False),
    ("backbone in the middle", "backbone-5", True),
    ("first sock at the buoy", "sock-1", False),
    ("middle sock at the backbone", "sock-5", False),
)
POINTS = (("west buoy", "west-buoy"), ("middle of the backbone", "v5"))
AXES = ("along the waves", "across the waves", "up")
#: Runs of `load_errors` in their order.
RUNS = ("1", "2", "4", "perturbed", "links", "twice_damping", "twice_bed")


def turned() -> dj.Scene:
    """`edulis-longline`, turned by 90 degrees (x' = -y, y' = x), from its static pose."""
    scene = dj.load_scene("edulis-longline")
    table = scene.to_dict()
    table["sea"]["waves"]["direction"] = 0.0
    table["sea"]["current"]["direction"] = 0.0
    for point in table["point"]:
        x, y, z = point["position"]
        point["position"] = [-y, x, z]
    scene = dj.Scene.from_dict(table)
    pose = dj.equilibrium(scene)
    nodes = point_nodes(scene)
    for point in table["point"]:
        if point["kind"] == "free":
            point["position"] = np.asarray(pose.positions)[nodes[point["name"]]].tolist()
    return dj.Scene.from_dict({**table, "start": {"kind": "points"}, "run": {**table["run"], "duration": SPAN}})


def series_here(run: dj.Solution) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times [s] and values over time by name: tensions of end links [N], places of points [m]."""
    links = {line.name: line.links for line in run.lines}
    nodes = point_nodes(run.scene)
    found = {name: run.tension[:, links[line].stop - 1 if last else links[line].start] for name, line, last in ENDS}
    for name, point in POINTS:
        found.update({f"{name}, {axis}": run.positions[:, nodes[point], i] for i, axis in enumerate(AXES)})
    return run.t, found


def series_there(scene: dj.Scene, dt: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The same in MoorDyn."""
    number = {line.name: i + 1 for i, line in enumerate(scene.lines)}
    ends = [(number[line], last) for _, line, last in ENDS]
    points = [(next(number[line.name] for line in scene.lines if line.end == point), True) for _, point in POINTS]
    seen = looks_at(scene, dt, SPAN, LOOK, ends, points, across=(-60, 120), waveKin_rampT=0.0)
    if seen.status != "ok":
        raise ArithmeticError(f"MoorDyn at {dt:g} s: {seen.status}")
    found = {name: np.abs(seen.tension[:, i]) for i, (name, *_) in enumerate(ENDS)}
    for j, (name, _) in enumerate(POINTS):
        found.update({f"{name}, {axis}": seen.position[:, j, i] for i, axis in enumerate(AXES)})
    return seen.t, found


def batch_error(values: np.ndarray, of: Callable[[np.ndarray], float]) -> float:
    """Standard error of a statistic of a series, by batches."""
    return float(np.std([of(part) for part in np.array_split(values, BATCHES)], ddof=1) / np.sqrt(BATCHES))


def statistics(t: np.ndarray, found: dict[str, np.ndarray]) -> dict[str, dict[str, float]]:
    """Mean, deviation and largest after `SKIP`, and standard errors of the first two."""
    settled = {name: values[t > SKIP] for name, values in found.items()}
    return {
        name: {
            "mean": float(kept.mean()),
            "deviation": float(kept.std()),
            "max": float(kept.max()),
            "mean_chance": batch_error(kept, np.mean),
            "deviation_chance": batch_error(kept, np.std),
        }
        for name, kept in settled.items()
    }


def edulis() -> Found:
    """Statistics of both codes, ours with errors by step and links, MoorDyn's by its step."""
    scene = turned()
    there = [statistics(*series_there(scene, dt)) for dt in EDULIS_STEPS]
    made = {}
    order = iter(RUNS)

    def run(variant: dj.Scene) -> dj.Solution:
        solution = dj.simulate(variant)
        made[next(order)] = statistics(*series_here(solution))
        return solution

    load_errors(scene, run, SKIP)
    rows = [_row(name, made, there) for name in made["1"]]
    return {"span_s": SPAN, "skip_s": SKIP, "dt_s": scene.run.dt, "moordyn_dt_s": list(EDULIS_STEPS), "rows": rows}


def _row(name: str, made: Found, there: list[Found]) -> Found:
    row = {"name": name}
    for what in ("mean", "deviation", "max"):
        steps = [made[key][name][what] for key in ("1", "2", "4")]
        first, second = (found[name][what] for found in there)
        row[what] = {
            "here": steps[0],
            "step": max(steps) - min(steps),
            "links": 4.0 / 3.0 * abs(made["links"][name][what] - steps[0]),  # second order
            "chance": made["1"][name].get(f"{what}_chance"),
            "moordyn": first,
            "moordyn_step": abs(first - second),
        }
    return row


@command(only=(None, "cases", "moordyn", "conventions", "edulis", "peaks"), starts=10)
def main(given) -> None:
    changed = {number: changes(case(number)) for number in NUMBERS}
    parts = {
        "cases": ({"case": number, **ours(case(number), LENGTHS)} for number in NUMBERS),
        "moordyn": (in_moordyn(number, ratio) for ratio in STEPS for number in NUMBERS),
        "conventions": (
            {"convention": name, "case": number, **ours(case(number).with_values(changed[number][name][1]), (SPAN,))}
            for name, (cases, _) in changed[1].items()
            for number in cases
        ),
    }
    head = {"schema": 1, "machine": describe(), "table_7": TABLE_7, "span_s": SPAN}
    packages = versions("moordyn", "jax", "dropper-jax", "numpy")
    collect("table7", parts, given.only, **head, versions=packages)
    if given.only in (None, "edulis"):
        store("table7", {**stored("table7"), "edulis": edulis()})
    if given.only in (None, "peaks"):
        resume("table7_peaks", "rows", peak_cases(given.starts), peak_loads, **head)
