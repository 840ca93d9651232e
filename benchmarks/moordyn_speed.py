"""Speed on one thread, at equal or smaller error of the fairlead tension: mean, deviation, and peaks.

Each code is measured against itself at a much smaller step: the question is what a given error costs. Ours runs twice:
as MoorDyn models lines (`damped_rope`, whose damper works on in a slack line) by `generalized_alpha`, and by default
(`rope`, energy_momentum), where slack lines chatter and the deviation is chaotic to some per cent. Two measures of the
standard deviation: of the tension at all steps, where the width of snaps counts, and of its means over 0.1 s. The goal
is judged by the first; both ratios are reported. A step counts where all smaller ones are as exact too. Where MoorDyn
takes its waves from a grid, so do we. Ours runs as one kernel. Ratios are of processor time, one thread each.

`peaks` judges what anchors are chosen by as well, the mean of the largest tensions in windows: several runs that differ
in phase, errors as root of their mean square over the runs, and each code at its cheapest step below `LIMITS`.
Where a point is driven, MoorDyn's errors are those with a call at every step of its own, its time that of calls every
`LOOK`, which cost it less.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from moordyn_runs import GRID, SAMPLE, Ours, Rows, case, theirs
from study import Found, say

import dropper_jax as dj
from dropper_jax import Scene
from dropper_jax.scene.slices import point_nodes

# [s]
SPAN = 60.0
SETTLED = 10.0
REPEATS = 3
#: Duration of the Edulis longline's scene [s], and its MoorDyn grid's least and largest y [m].
EDULIS_SPAN = 150.0
GRID_EDULIS = (-60, 120)
#: Our steps in 0.1 s, from large steps to small ones; the last is the reference.
EVERY = (1, 2, 4, 5, 10, 15, 20, 40, 160)
#: Accuracies of runs that choose their steps, which are at most `LONGEST` shares of 0.1 s.
ACCURACIES = (0.1, 0.03, 0.01, 0.003)
LONGEST = 1
#: MoorDyn's steps [s] from large to small, tried until one is stable, and the share of it that gives the reference.
STEPS = (0.008, 0.006, 0.004, 0.003, 0.002, 0.0015, 0.001, 0.0007, 0.0005, 0.0003)
FINER = 0.25
#: Motions of the driven top: period [s], surge and heave [m]. The first makes segments snap, the second does not.
HARD = (8.0, 1.0, 1.5)
SMOOTH = (10.0, 0.3, 0.5)
#: Time between looks at MoorDyn [s] for statistics.
LOOK = 0.01
#: Peaks: number of runs, and their windows [s] after the first seconds [s], in which motions rise over RAMP [s].
RUNS = 8
WINDOW = 8.0
FIRST = 12.0
RAMP = 8.0
#: Largest errors allowed in both codes: mean, deviation, and mean of the windows' largest tensions.
LIMITS = {"mean": 5e-3, "std": 2e-2, "peaks": 3.5e-2}
#: MoorDyn's steps [s] for peaks; the reference takes half the last one, whose error bounds that of the reference.
THEIR_STEPS = (0.002, 0.001, 0.0005, 0.00025)
#: Ours: accuracy, and steps in 0.1 s (the least number of them). The reference: steps in 0.1 s, half of which bound its
#: error.
OUR_STEPS = ((None, 20), (None, 40), (None, 80), *((accuracy, 5) for accuracy in (0.1, 0.05, 0.03, 0.02, 0.01)))
REFERENCE = 640


@dataclass(frozen=True)
class PeakRuns:
    """How the peaks of a scene are measured: number of runs, our steps, the reference's steps in 0.1 s, and MoorDyn's
    steps [s], half the last of which gives its reference."""

    runs: int = RUNS
    ours: tuple[tuple[float | None, int], ...] = OUR_STEPS
    reference: int = REFERENCE
    theirs: tuple[float, ...] = THEIR_STEPS


#: The Edulis longline has no snaps: it takes long steps, and few runs tell its errors.
EDULIS = PeakRuns(
    runs=2, ours=tuple((accuracy, 1) for accuracy in (0.1, 0.03, 0.01)), reference=160, theirs=(0.001, 0.0005, 0.00025)
)
#: Scenes of peaks by option, and their names in tables.
PEAKS = {
    "hard": "chain of 12 segments, top driven, hard",
    "case_1": "case 1 (MoorDyn: wave grid)",
    "case_3": "case 3, 29 components (MoorDyn: wave grid)",
    "edulis": "edulis-longline (both: wave grid)",
}
#: Time between looks at MoorDyn's peaks [s], and runs whose time is taken.
CLOSE = 1e-3
TIMED = 2
#: Our two ways: values of the scene.
WAYS = {
    "damped_rope": {"line.0.axial.law": "damped_rope", "run.integrator": "generalized_alpha"},
    "rope": {"line.0.axial.law": "rope", "run.integrator": "energy_momentum"},
}
MEASURES = {"all_steps": ("mean", "std"), "below_5_hz": ("mean", "std_of_rows")}


def driven(
    motion: tuple[float, float, float], phase: float = 0.0, ramp: float | None = None
) -> Callable[[float], np.ndarray]:
    """Place (3,) [m] of the driven top over time [s], as `end_motion` has it."""
    period, surge, heave = motion

    def place(t: float) -> np.ndarray:
        u = 1.0 if ramp is None else min(t / ramp, 1.0)
        turn = math.sin(2 * math.pi * t / period + phase) * u**3 * (10 - 15 * u + 6 * u * u)
        return np.array([30.0 + surge * turn, 0.0, -2.0 + heave * turn])

    return place


def driven_chain(base: Scene, motion: tuple[float, float, float]) -> Scene:
    """The chain of case 1 in still water with a driven top."""
    period, surge, heave = motion
    table = base.to_dict()
    table.pop("buoy")
    table["sea"] = {"depth": 30.0}
    table["point"][1] = {"name": "buoy", "position": [30.0, 0.0, -2.0]}
    table["start"] = {"kind": "static"}
    table["effects"]["end_motion"] = {"point": "buoy", "amplitude": [surge, 0.0, heave], "period": period}
    return Scene.from_dict({**table, "name": "driven-chain"})


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
    return dj.Scene.from_dict({**table, "start": {"kind": "points"}, "run": {**table["run"], "duration": EDULIS_SPAN}})


def speed(only: str | None = None) -> Iterator[Found]:
    """Rows of all comparisons, or of those whose name holds a word."""
    grid = {"sea.interpolation": "grid"}
    own = {"ways": {"rope": {}, "rope, as well": {"run.integrator": "generalized_alpha"}}, "across": GRID_EDULIS}
    for name, scene, wanted, calls, options in (
        *(
            (
                f"chain of 12 segments, top driven, {how}",
                driven_chain(case(1), motion),
                wanted,
                LOOK,
                {"drive": driven(motion)},
            )
            for how, motion, wanted in (("hard", HARD, 1.5), ("smooth", SMOOTH, 4.0))
        ),
        ("case 1 (MoorDyn: wave grid)", case(1), 4.0, SAMPLE, {"across": GRID}),
        ("case 3, 29 components (both: wave grid)", case(3).with_values(grid), 2.0, SAMPLE, {"across": GRID}),
        ("case 3, 29 components (both: exact kinematics)", case(3), 2.0, SAMPLE, {}),
        ("edulis-longline (both: wave grid)", turned().with_values(grid), 1.0, SAMPLE, own),
    ):
        if only is None or only in name:
            yield from compare(name, scene, wanted, calls, **options)


def errors(rows: Rows, reference: Rows) -> dict[str, float] | None:
    """Relative error of mean and standard deviations of the fairlead tension."""
    a = rows.statistics(SETTLED)
    b = reference.statistics(SETTLED)
    if a["status"] != "ok" or b["status"] != "ok":
        return None
    return {key: abs(a["fairlead"][key] / b["fairlead"][key] - 1.0) for key in ("mean", "std", "std_of_rows")}


def compare(
    name: str, scene: Scene, wanted: float, calls: float, ways: dict[str, Found] = WAYS, **options
) -> Iterator[Found]:
    """MoorDyn rk2 at its largest stable step, and each of our ways: the fastest run with errors no larger.

    Args:
        calls: time between calls of MoorDyn [s] where its wall time is taken.
    """
    there = largest_stable(scene, calls, **options)
    for law, values in ways.items():
        integrator = values.get("run.integrator", scene.run.integrator)
        found = _ours(scene.with_values(values), there)
        head = {"name": name, "wanted": wanted, "law": law.split(",")[0], "integrator": integrator}
        yield {**head, "moordyn": there, **found}


def _ours(scene: Scene, there: Found) -> Found:
    ours = Ours.of(scene)
    reference = ours.run(EVERY[-1], SPAN)

    def row(every: int, accuracy: float | None = None) -> Found:
        run = ours.run(every, SPAN, REPEATS, accuracy)
        row = {"dt_s": SAMPLE / every, "errors": errors(run, reference), "cpu_per_s": run.cpu_s / SPAN}
        row["accuracy"] = accuracy
        say(row)
        return row

    rows = [row(every) for every in EVERY[:-1]]
    chosen = [row(LONGEST, accuracy) for accuracy in ACCURACIES]
    found = {}
    for measure, keys in MEASURES.items():
        found[measure] = _fastest(rows, there, keys)
        found[f"{measure}_by_accuracy"] = _fastest(chosen, there, keys)
    return {"our_runs": rows, "our_chosen_steps": chosen, **found}


def _fastest(rows: list[Found], there: Found, keys: tuple[str, ...]) -> Found | None:
    """The coarsest run with errors no larger, and the ratio of times; a lucky one above a worse one does not count."""
    limit = there["errors"]
    exact = takewhile(
        lambda row: limit and row["errors"] and all(row["errors"][key] <= limit[key] for key in keys), reversed(rows)
    )
    best = next(reversed(list(exact)), None)
    if best is None:
        return None
    return {
        "ratio": there["cpu_per_s"] / best["cpu_per_s"],
        "ours_dt_s": best["dt_s"],
        "ours_accuracy": best["accuracy"],
    }


def largest_stable(scene: Scene, calls: float, **options) -> Found:
    """MoorDyn rk2 at the largest step of `STEPS` that is stable over the whole run."""
    for dt in STEPS:
        run = _errors_run(scene, dt, LOOK, **options)
        if run.status != "ok" or not np.max(np.abs(run.place)) < 1e3:
            continue
        reference = _errors_run(scene, FINER * dt, LOOK, **options)
        found = errors(run, reference)
        if found is None or max(found.values()) > 0.5:  # finite, but ringing with steps at the limit
            continue
        runs = [theirs(scene, dt, SPAN, look=calls, **options) for _ in range(REPEATS)]
        row = {"dt_s": dt, "status": "ok", "errors": found, "cpu_per_s": min(r.cpu_s for r in runs) / SPAN}
        say(row)
        return row
    return {"dt_s": None, "status": "no stable step", "errors": None, "cpu_per_s": np.nan}


def _errors_run(scene: Scene, dt: float, look: float, **options) -> Rows:
    """MoorDyn with a driven point moved at every step of its own."""
    call = dt if "drive" in options else None
    return theirs(scene, dt, SPAN, look=max(look, dt), call=call, **options)


def peaks(only: str | None = None) -> Iterator[Found]:
    """One row per scene, or of one of `PEAKS`: errors of all steps in both codes, cheapest good ones, ratio."""
    own = WAYS["damped_rope"]
    edulis = turned().with_values({"sea.interpolation": "grid"})
    draws = {
        "hard": lambda i: _hard(i, own),
        "case_1": lambda i: (_shifted(case(1).with_values(own), i), {"across": GRID}),
        "case_3": lambda i: (_shifted(case(3).with_values(own), i), {"across": GRID}),
        "edulis": lambda i: (_shifted(edulis, i), {"across": GRID_EDULIS}),
    }
    for key in [only] if only else draws:
        how = EDULIS if key == "edulis" else PeakRuns()
        scenes = [draws[key](i) for i in range(how.runs)]
        ours = _our_peaks([scene for scene, _ in scenes], how)
        there = _their_peaks(scenes, how.theirs)
        ratio = there["best"] and ours["best"] and there["best"]["cpu_per_s"] / ours["best"]["cpu_per_s"]
        yield {"name": PEAKS[key], "runs": how.runs, "limits": LIMITS, "ours": ours, "moordyn": there, "ratio": ratio}


def _hard(i: int, own: Found) -> tuple[Scene, Found]:
    """The chain that snaps, driven from rest with the i-th phase."""
    phase = 2 * np.pi * i / RUNS
    values = {"effects.end_motion.phase": phase, "effects.end_motion.ramp": RAMP, **own}
    return driven_chain(case(1), HARD).with_values(values), {"drive": driven(HARD, phase, RAMP)}


def _shifted(scene: Scene, i: int) -> Scene:
    """The scene in waves with the i-th phase; of several components the first run has the scene's own."""
    phase = np.asarray(scene.sea.waves.phase)
    if phase.ndim and i:
        phase = np.random.default_rng(i).uniform(0.0, 2 * np.pi, phase.shape)
    elif not phase.ndim:
        phase = phase + 2 * np.pi * i / RUNS
    return scene.with_values({"sea.waves.phase": phase.tolist()})


def _our_peaks(scenes: list[Scene], how: PeakRuns) -> Found:
    every = [Ours.of(scene) for scene in scenes]
    reference = [_three(ours.run(how.reference, SPAN)) for ours in every]
    bound = _over_runs([_three(ours.run(how.reference // 2, SPAN)) for ours in every], reference)
    rows = []
    for accuracy, count in how.ours:
        done = [ours.run(count, SPAN, REPEATS if i < TIMED else 1, accuracy) for i, ours in enumerate(every)]
        rows.append({"dt_s": SAMPLE / count, "accuracy": accuracy, **_judged(done, reference)})
    return _chosen(rows, reference, bound)


def _their_peaks(scenes: list[tuple[Scene, Found]], steps: tuple[float, ...]) -> Found:
    def run(dt: float) -> list[Rows]:
        return [_errors_run(scene, dt, CLOSE, **options) for scene, options in scenes]

    reference = [_three(one) for one in run(0.5 * steps[-1])]
    rows = []
    bound = _over_runs([_three(one) for one in run(steps[-1])], reference)
    for dt in steps[:-1]:
        done = run(dt)
        for i, (scene, options) in enumerate(scenes[:TIMED]):
            look = LOOK if "drive" in options else SAMPLE
            timed = [theirs(scene, dt, SPAN, look=look, **options) for _ in range(REPEATS)]
            done[i].cpu_s = min(one.cpu_s for one in timed)
        rows.append({"dt_s": dt, "accuracy": None, **_judged(done, reference)})
    return _chosen(rows, reference, bound)


def _three(run: Rows) -> dict[str, float]:
    """Mean, deviation and mean of the windows' largest fairlead tensions [N]; none of them where a run failed."""
    if run.status != "ok":
        return dict.fromkeys(LIMITS, float("nan"))
    found = run.statistics(FIRST)["fairlead"]
    return {"mean": found["mean"], "std": found["std"], "peaks": run.peaks(FIRST, WINDOW)}


def _over_runs(found: list[dict[str, float]], reference: list[dict[str, float]]) -> dict[str, float]:
    """Root of the mean square, over runs, of the relative errors."""
    ratios = {key: [a[key] / b[key] - 1.0 for a, b in zip(found, reference, strict=True)] for key in LIMITS}
    return {key: float(np.sqrt(np.mean(np.square(value)))) for key, value in ratios.items()}


def _judged(done: list[Rows], reference: list[dict[str, float]]) -> Found:
    found = _over_runs([_three(run) for run in done], reference)
    good = all(found[key] <= limit for key, limit in LIMITS.items())
    return {"errors": found, "good": good, "cpu_per_s": min(run.cpu_s for run in done[:TIMED]) / SPAN}


def _chosen(rows: list[Found], reference: list[dict[str, float]], bound: dict[str, float]) -> Found:
    """The rows, the cheapest good one, means of the reference over the runs, and what bounds its errors."""
    for row in rows:
        say(row)
    good = []
    for by_accuracy in (False, True):
        kind = [row for row in rows if (row["accuracy"] is not None) == by_accuracy]
        good += takewhile(lambda row: row["good"], reversed(kind))  # a lucky one above a worse one does not count
    best = min(good, key=lambda row: row["cpu_per_s"]) if good else None
    means = {key: float(np.mean([one[key] for one in reference])) for key in LIMITS}
    return {"steps": rows, "best": best, "reference": means, "reference_errors": bound}
