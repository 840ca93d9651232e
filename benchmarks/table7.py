"""The paper's Table 7 measured again: all five cases from Table 6's poses, and what single conventions change in them.

    python benchmarks/table7.py [--only cases|moordyn|conventions|edulis]

Needs the extra `moordyn`; takes about an hour on one core. Writes results/table7.json beside this file, from which
`python benchmarks/tables.py` makes the tables of docs/moordyn-compared.md.
"""

import one_thread  # noqa: F401 - before JAX

# isort: split

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from moordyn_runs import GRID, theirs
from paper_cases import TABLE_7, case
from study import Found, collect, command, describe, store, stored, versions
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


def loads(values: np.ndarray) -> dict[str, float]:
    """Least, mean and largest [N]."""
    return {"min": float(np.min(values)), "mean": float(np.mean(values)), "max": float(np.max(values))}


def of_run(run: dj.Solution, span: float) -> Found:
    """Loads at both ends up to a time: tension of the end link, and size of the force on the anchor's node."""
    kept, shown = run.t_tension <= span, run.t <= span
    settled = run.tension[kept & (run.t_tension > SETTLED), 0]
    batches = [float(part.mean()) for part in np.array_split(settled, BATCHES)] if settled.size else []
    place = run.positions[shown, -1]
    found = {
        "span_s": span,
        "anchor": loads(run.tension[kept, 0]),
        "anchor_node": loads(channel_values(run, "AnchTen1")[0][kept]),
        "fairlead": loads(run.tension[kept, -1]),
        "place": {"min": place.min(axis=0).tolist(), "max": place.max(axis=0).tolist()},
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


@command(only=(None, "cases", "moordyn", "conventions", "edulis"))
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
    packages = versions("moordyn", "jax", "dropper-jax", "numpy")
    collect("table7", parts, given.only, schema=1, machine=describe(), versions=packages, table_7=TABLE_7, span_s=SPAN)
    if given.only in (None, "edulis"):
        store("table7", {**stored("table7"), "edulis": edulis()})
