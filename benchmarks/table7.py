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

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from moordyn_runs import GRID, TABLE_7, case, theirs
from study import Found, collect, command, describe, resume, spread, store, stored, versions
from table7_edulis import edulis

import dropper_jax as dj
from dropper_jax.moordyn.writing.outputs import channel_values

NUMBERS = (1, 2, 3, 4, 5)
#: The paper gives no durations; its figures and texts speak of times up to 143.9 s.
SPAN, LONGEST = 150.0, 200.0  # [s]
#: Lengths of the record [s] for which means and extremes are given.
LENGTHS = (50.0, 80.0, 100.0, SPAN, LONGEST)
#: Settled part [s] and batches of the standard error of its mean.
SETTLED, BATCHES = 50.0, 8
#: MoorDyn's step [s] for each internal damping ratio.
STEPS = {1.0: 0.0001, 0.1: 0.0005, 0.0: 0.0005}
ALL, WAVES, IRREGULAR = (1, 2, 3, 4, 5), (1, 2, 3, 5), (3, 5)
#: Draught of the buoy at rest in case 4 [m].
DRAUGHT = 3.27


def of_run(run: dj.Solution, span: float) -> Found:
    """Loads at both ends up to a time: tension of the end link, and size of the force on the anchor's node."""
    kept = run.t_tension <= span
    settled = run.tension[kept & (run.t_tension > SETTLED), 0]
    batches = [float(part.mean()) for part in np.array_split(settled, BATCHES)] if settled.size else []
    found = {
        "span_s": span,
        "anchor": spread(run.tension[kept, 0]),
        "anchor_node": spread(channel_values(run, "AnchTen1")[0][kept]),
        "fairlead": spread(run.tension[kept, -1]),
    }
    if batches:
        found["standard_error"] = float(np.std(batches, ddof=1) / np.sqrt(BATCHES))
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


@dataclass(frozen=True)
class Convention:
    """A change of one thing.

    Attributes:
        values: values by path, given the case's scene.
    """

    name: str
    cases: tuple[int, ...]
    values: Callable[[dj.Scene], Mapping]

    def changed(self, scene: dj.Scene) -> dj.Scene:
        return scene.with_values(dict(self.values(scene)))


def _fixed(name: str, cases: tuple[int, ...], **values) -> Convention:
    """The same values for every case; `__` stands for a dot."""
    paths = {path.replace("__", "."): value for path, value in values.items()}
    return Convention(name, cases, lambda scene: paths)


def _friction(scene: dj.Scene) -> Found:
    has = "seabed_friction" in scene.effects
    return {"effects.seabed_friction.kinetic": 0.0 if has else 0.5}


def _phases(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[dj.Scene], Found]:
    def values(scene: dj.Scene) -> Found:
        phase = np.asarray(scene.sea.waves.phase if scene.sea.waves.phase is not None else 0.0, float)
        return {"sea.waves.phase": change(phase).tolist()}

    return values


def _slim(scene: dj.Scene) -> float:
    """Draught at rest over the buoy's diameter: its side is taken as wet to there at all times."""
    return DRAUGHT / scene.buoys[0].diameter


def _half(scene: dj.Scene) -> float:
    return 0.5 * scene.buoys[0].height


def _lower(scene: dj.Scene) -> Found:
    x, y, _ = next(point for point in scene.points if point.name == "buoy").position
    return {"point.buoy.position": [float(x), float(y), -2.0 * 4.43]}


CONVENTIONS = (
    _fixed("start at rest, not from Table 6", ALL, start__kind="static"),
    Convention("bed friction 0.5 added; case 2: taken away", ALL, _friction),
    _fixed("damper goes on in slack links (`damped_rope`)", ALL, line_type__chain__law="damped_rope"),
    _fixed("the same, damping ratio 1", ALL, line_type__chain__law="damped_rope", line_type__chain__damping_ratio=1.0),
    Convention("chain at the buoy's half height", ALL, lambda s: {"buoy.0.attachment": _half(s)}),
    Convention("-4.43 m is the buoy's middle, chain at its base", ALL, _lower),
    Convention("buoy: drag along on pi D w", ALL, lambda s: {"buoy.0.cdt": s.buoys[0].cdt * 4 * _slim(s)}),
    Convention("buoy: drag along on D w", ALL, lambda s: {"buoy.0.cdt": s.buoys[0].cdt * 4 * _slim(s) / np.pi}),
    _fixed("buoy: added mass along of the wet volume", ALL, buoy__0__end_added_mass="volume"),
    Convention("wave phases 180 degrees later", WAVES, _phases(lambda p: p + np.pi)),
    Convention("wave phases 90 degrees later", WAVES, _phases(lambda p: p + np.pi / 2)),
    Convention("wave phases of Table A1 with the other sign", IRREGULAR, _phases(lambda p: -p)),
    Convention("chain: axial drag on D, not on pi D", ALL, lambda s: {"line_type.chain.cdt": 0.2 / np.pi}),
    _fixed("24 segments", ALL, line__chain__links=24),
    _fixed("damping ratio 1", ALL, line_type__chain__damping_ratio=1.0),
    _fixed("bed 10 times softer, damper too", ALL, effects__seabed__stiffness=3e5, effects__seabed__damping=3e4),
    _fixed("water above z = 0 moves as at z = 0", WAVES, sea__stretching="constant"),
    _fixed("waves take the current's Doppler shift", (5,), sea__wave_current="doppler"),
)


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
    parts = {
        "cases": ({"case": number, **ours(case(number), LENGTHS)} for number in NUMBERS),
        "moordyn": (in_moordyn(number, ratio) for ratio in STEPS for number in NUMBERS),
        "conventions": (
            {"convention": one.name, "case": number, **ours(one.changed(case(number)), (SPAN,))}
            for one in CONVENTIONS
            for number in one.cases
        ),
    }
    head = {"schema": 1, "machine": describe(), "table_7": TABLE_7, "span_s": SPAN}
    packages = versions("moordyn", "jax", "dropper-jax", "numpy")
    collect("table7", parts, given.only, **head, versions=packages)
    if given.only in (None, "edulis"):
        store("table7", {**stored("table7"), "edulis": edulis()})
    if given.only in (None, "peaks"):
        resume("table7_peaks", "rows", peak_cases(given.starts), peak_loads, **head)
