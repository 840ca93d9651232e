"""What a run that chooses its steps costs beside the best equal step of the same error.

    python benchmarks/equal_error.py [--only SCENE]

Errors are those of mean, deviation and window maxima of the tension at the end of a line, root of the mean
square over `PHASES` phases of the waves or of the motion, against the finest equal step. The best equal step is the
cheapest with none of the three larger, at all smaller steps too. Times are processor time without compilation, refused
steps and the filter included. Writes results/equal_error.json.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from moordyn_runs import SAMPLE, Ours, case
from moordyn_runs import Rows as Run
from moordyn_speed import HARD, RAMP, SMOOTH, driven_chain
from study import Found, Rows, collect, columns, command, describe, percent, say, table_of, versions

import dropper_jax as dj
from dropper_jax import Scene

#: Phases of a storm.
PHASES = 3
#: Times that a run is repeated, the least of which counts, and steps above which once is enough.
REPEATS = 3
MANY = 30_000
ACCURACIES = (0.1, 0.03, 0.01, 0.003)
#: The accuracy of packaged scenes, by which the kinds of motion are summed up.
USUAL = 0.01
#: Longest step of runs with an accuracy: steps in `SAMPLE`.
LONGEST = 1
#: Equal steps in `SAMPLE`: those tried end at half of the reference's.
EQUAL = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 1024)
MEASURES = ("mean", "std", "peaks")
#: Error that counts as none in the last column: smooth storms come out far more exact than asked.
SMALL = 1e-3


@dataclass(frozen=True)
class Compared:
    """A scene and its phases.

    Attributes:
        kind: row of the table.
        scene: the scene of a phase in radians.
        span: duration [s].
        settled: time [s] from which statistics count.
        window: length [s] of the windows whose maxima are compared.
        finest: equal steps in `SAMPLE` of the reference.
        phases: how many.
        line: whose far end's tension is compared.
    """

    kind: str
    scene: Callable[[float], Scene]
    span: float
    settled: float
    window: float
    finest: int
    phases: int = PHASES
    line: int = 0


def waves(name: str | int) -> Callable[[float], Scene]:
    """A scene whose waves begin in another phase."""

    def shifted(phase: float) -> Scene:
        if isinstance(name, int):
            scene = case(name)
        else:
            scene = dj.load_scene(name)
        own = np.asarray(scene.sea.waves.phase, dtype=float)
        if own.ndim and phase:
            changed = np.random.default_rng(round(1000 * phase)).uniform(0.0, 2 * math.pi, own.shape)
        else:
            changed = own + phase
        return scene.with_values({"sea.waves.phase": changed.tolist()})

    return shifted


def driven(motion: tuple[float, float, float]) -> Callable[[float], Scene]:
    def shifted(phase: float) -> Scene:
        values = {"effects.end_motion.phase": phase, "effects.end_motion.ramp": RAMP}
        return driven_chain(case(1), motion).with_values(values)

    return shifted


def released(name: str) -> Callable[[float], Scene]:
    return lambda phase: dj.load_scene(name)


STORM = "storms without snaps"
RELEASE = "releases"
SNAPS = "snapping lines"
SCENES = {
    "chain of 12 segments, top driven, smooth": Compared(STORM, driven(SMOOTH), 60.0, 12.0, 8.0, 512),
    "paper-case-4": Compared(STORM, released("paper-case-4-table-6"), 60.0, 12.0, 8.0, 512, phases=1),
    "dropper-north-sea": Compared(STORM, waves("dropper-north-sea"), 40.0, 10.0, 10.0, 256),
    "edulis-longline": Compared(STORM, waves("edulis-longline"), 20.0, 5.0, 5.0, 64, phases=2, line=1),
    "dropper-release-a": Compared(RELEASE, released("dropper-release-a"), 4.0, 0.0, 1.0, 2048, phases=1),
    "dropper-release-c": Compared(RELEASE, released("dropper-release-c"), 4.0, 0.0, 1.0, 2048, phases=1),
    "dropper-release-e": Compared(RELEASE, released("dropper-release-e"), 4.0, 0.0, 1.0, 2048, phases=1),
    "dropper-release-3d": Compared(RELEASE, released("dropper-release-3d"), 4.0, 0.0, 1.0, 2048, phases=1),
    "chain of 12 segments, top driven, hard": Compared(SNAPS, driven(HARD), 60.0, 12.0, 8.0, 512),
    "paper-case-1": Compared(SNAPS, waves(1), 60.0, 12.0, 8.0, 512),
    "paper-case-5": Compared(SNAPS, waves(5), 60.0, 12.0, 8.0, 512, phases=2),
}


def three(run: Run, one: Compared) -> dict[str, float] | None:
    if run.status != "ok":
        return None
    found = run.statistics(one.settled)["fairlead"]
    return {"mean": found["mean"], "std": found["std"], "peaks": run.peaks(one.settled, one.window)}


def errors(runs: list[Run], reference: list[dict[str, float]], one: Compared) -> dict[str, float] | None:
    """Root of the mean square, over phases, of the relative errors; None where a run failed."""
    found = [three(run, one) for run in runs]
    if None in found:
        return None
    result = {}
    for key in MEASURES:
        ratios = [a[key] / b[key] - 1.0 for a, b in zip(found, reference, strict=True)]
        result[key] = float(np.sqrt(np.mean(np.square(ratios))))
    return result


def compare(name: str) -> Found:
    """Rows of equal steps and of accuracies, and the ratio of their times at equal errors."""
    one = SCENES[name]
    phases = [2.0 * math.pi * i / one.phases for i in range(one.phases)]
    every = [Ours.of(one.scene(phase), one.line) for phase in phases]
    reference = [three(ours.run(one.finest, one.span), one) for ours in every]
    bound = errors([ours.run(one.finest // 2, one.span) for ours in every], reference, one)
    equal = []
    for count in EQUAL:
        if 2 * count <= one.finest:
            equal.append(row(every, one, reference, count=count))
    chosen = []
    for accuracy in ACCURACIES:
        found = row(every, one, reference, count=LONGEST, accuracy=accuracy)
        chosen.append({**found, **beside(found, equal, bound)})
    return {"name": name, "kind": one.kind, "reference_errors": bound, "equal": equal, "chosen": chosen}


def row(
    every: list[Ours], one: Compared, reference: list[dict[str, float]], count: int, accuracy: float | None = None
) -> Found:
    if count * one.span / SAMPLE > MANY:
        repeats = 1
    else:
        repeats = REPEATS
    runs = [ours.run(count, one.span, repeats, accuracy) for ours in every]
    found = {
        "dt_s": SAMPLE / count,
        "accuracy": accuracy,
        "errors": errors(runs, reference, one),
        "cpu_s": sum(run.cpu_s for run in runs),
    }
    say(found)
    return found


def beside(found: Found, equal: list[Found], bound: dict[str, float]) -> Found:
    """Time over that of the best equal step with no larger error; a bound where all that were tried are worse.

    Errors below that of the reference are no errors.
    """
    if found["errors"] is None:
        return {"best_dt_s": None, "ratio": None}
    limit = {key: max(found["errors"][key], bound[key]) for key in MEASURES}
    best = None
    for step in sorted(equal, key=lambda step: step["dt_s"]):
        if step["errors"] is None or any(step["errors"][key] > limit[key] for key in MEASURES):
            break
        best = step
    if best is None:
        finest = min(equal, key=lambda step: step["dt_s"])
        return {"best_dt_s": None, "ratio_below": found["cpu_s"] / finest["cpu_s"]}
    return {"best_dt_s": best["dt_s"], "ratio": found["cpu_s"] / best["cpu_s"]}


def rows(only: str | None) -> Iterator[Found]:
    for name in [only] if only else SCENES:
        yield compare(name)


@table_of("equal_error")
def equal_error(found: Found) -> Rows:
    """Each scene at the usual accuracy, and the geometric mean of each kind of motion."""
    shown = []
    for kind in (STORM, RELEASE, SNAPS):
        of_kind = [row for row in found["rows"] if row["kind"] == kind]
        for row in of_kind:
            usual = next(one for one in row["chosen"] if one["accuracy"] == USUAL)
            coarse = beside(usual, row["equal"], dict.fromkeys(MEASURES, SMALL))
            shown.append({"name": row["name"], **usual, "coarse": coarse["ratio"]})
        means = {}
        for column in ("ratio", "coarse"):
            means[column] = float(np.exp(np.mean([np.log(one[column]) for one in shown[-len(of_kind) :]])))
        shown.append({"name": f"**{kind}**", "errors": None, **means})
    return columns(
        shown,
        ("", "{name}"),
        ("errors of mean, deviation, window maxima", _errors),
        ("best equal step [s]", lambda row: f"{row['best_dt_s']:.2g}" if row["errors"] else ""),
        ("time over that of the best equal step", "{ratio:.2f}"),
        ("the same, errors below 0.1 % taken as none", "{coarse:.2f}"),
    )


def _errors(row: Found) -> str:
    if row["errors"] is None:
        return "geometric mean"
    return ", ".join(percent(row["errors"][key], 2) for key in MEASURES)


@command(only=(None, *SCENES))
def main(given) -> None:
    head = {"schema": 1, "machine": describe(), "versions": versions("jax", "dropper-jax", "numpy")}
    collect("equal_error", {"rows": rows(given.only)}, by="name", **head)


if __name__ == "__main__":
    main()
