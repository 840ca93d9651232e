"""The paper's Table 7 measured again: all five cases from Table 6's poses, and what single conventions change in them.

    python benchmarks/table7.py [--only cases|moordyn|conventions|edulis|peaks] [--starts 10]

Needs the extra `moordyn`; takes about an hour on one core. Writes results/table7.json beside this file, from which
`python benchmarks/tables.py` makes the tables of docs/moordyn-compared.md.

`peaks`: the largest loads at steps that resolve their snaps, by two schemes at two steps each, and from `--starts`
starts whose buoy is moved by up to 1e-6 m. Where these agree within 3 % the four values must; elsewhere the motion is
chaotic, and the table gives their range. Half an hour more; writes results/table7_peaks.json.
"""

import one_thread  # noqa: F401 - before JAX

# isort: split

from collections.abc import Iterator

import numpy as np
from moordyn_runs import GRID, TABLE_7, case, theirs
from study import Found, collect, command, describe, resume, spread, store, stored, versions
from table7_edulis import batch_error, edulis

import dropper_jax as dj
from dropper_jax.moordyn.writing.outputs import channel_values

NUMBERS = (1, 2, 3, 4, 5)
#: The paper gives no durations; its figures and texts speak of times up to 143.9 s.
SPAN, LONGEST = 150.0, 200.0  # [s]
#: Lengths of the record [s] for which means and extremes are given.
LENGTHS = (50.0, 80.0, 100.0, SPAN, LONGEST)
#: Settled part [s].
SETTLED = 50.0
#: MoorDyn's step [s] for each internal damping ratio.
STEPS = {1.0: 0.0001, 0.1: 0.0005, 0.0: 0.0005}
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
