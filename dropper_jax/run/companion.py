"""The error of a run, stated from a second run of the same scene.

A run follows an accuracy a or takes equal steps h. Its companion follows 4 a or takes steps 2 h, in half the time.
With errors of order p in h the companion's are g = 2^p times those of the run (4 with an accuracy, to which errors are
proportional), so that the error of a result q is

    e = |q_companion - q|/(g - 1)

With an accuracy, this estimate is the median of the true errors, which scatter in runs that snap. The stated error is
then `SCATTER` times the estimate. The angle error, which fits take as noise, remains the estimate.

To verify a run the companion is finer instead, a/4 or h/2, for two to three times the time, and e = |..| g/(g - 1).

Results are the mean, the standard deviation and the maximum in time of the tension of each line's most loaded link, and
the positions of the nodes. The maximum depends on few steps and converges irregularly: its error is the whole
difference, and in quadrature half of its RMS over the links of the line. Once both runs are different motions (chaos),
their differences are random. Errors of tensions are then the whole differences as well, and positions are compared
until that time.

The compiled program of the run has accuracy, step and count as arguments, so nothing is compiled again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

import jax
import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.read import Values
from dropper_jax.integrators import INTEGRATORS
from dropper_jax.run.chunks import FACTOR, Companion, Program, RunOutcome
from dropper_jax.run.row_store import Rows
from dropper_jax.run.samples import TOO_LONG, Kind, Samples, is_finished
from dropper_jax.scene import RunSpec, whole_lines
from dropper_jax.stepping.progress import Trajectory

#: Travel as a fraction of the longest line below which nodes are at rest.
TRAVEL_AT_REST = 1e-3
#: Fraction of the maximum tension of all lines below which a line's errors do not count in the verdict.
SMALL_TENSION = 0.1
#: Error of a result above which equal steps are unusable.
UNUSABLE = 0.1
#: Error of a result above which equal steps are warned of.
WARNED = 0.03
#: Stated errors above this multiple of the accuracy are warned of.
MISSED = 3.0
#: Stated over estimated error of runs with an accuracy. The true errors of positions in 81 random scenes
#: (`benchmarks/random_scenes.py`, seeds 0 to 99) are at most 1.1 times the estimate in half of them, 3.3 times in 95 %.
SCATTER = 4.0
#: Share of the differences of a line's links in the error of the maximum of its most loaded one, which may vanish by
#: chance: with it true errors are within the stated ones in 95 % of 151 lines of random scenes, without it in 91 %.
OTHER_LINKS = 0.5
#: Chaos: distance of the two runs, over the travel, up to which they are one motion ...
CHAOS_RESOLVED = 0.01
#: ... which they stay for at least this number of times the first swing ...
SWINGS = 3
#: ... and distance from which they are two motions ...
SEPARATED = 0.3
#: ... reached within this multiple of that time. A linear drift of the phase takes 30 times as long.
SUDDEN = 4.0


class Tensions(NamedTuple):
    """Tensions of the links (n,) over a number of samples [N]: mean, mean square, maximum."""

    samples: int
    mean: np.ndarray
    square: np.ndarray
    maximum: np.ndarray

    @classmethod
    def of(cls, rows: Trajectory) -> Tensions:
        """The tensions of saved states."""
        tension = np.asarray(rows.tension)
        square = tension**2
        if rows.within is not None:
            square = np.asarray(rows.within.square)
        top = tension
        if rows.extremes is not None:
            top = np.asarray(rows.extremes.largest[:, : tension.shape[1]])
        return cls(len(tension), np.mean(tension, axis=0), np.mean(square, axis=0), np.max(top, axis=0))

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviation in time (n,) [N]."""
        return np.sqrt(np.maximum(self.square - self.mean**2, 0.0))


@dataclass(frozen=True)
class LineErrors:
    """Mean, standard deviation and maximum in time of the tension of a line's most loaded link, with errors [N]."""

    line: str
    link: int
    mean_n: float
    mean_error_n: float
    deviation_n: float
    deviation_error_n: float
    maximum_n: float
    maximum_error_n: float


@dataclass(frozen=True)
class StatedErrors:
    """Errors of a run.

    Attributes:
        companion: what the companion followed, in words.
        positions: RMS distance of the worst node as a fraction of the travel, until `chaotic_from_s`; None at rest.
        angles_rad: see `_angle_error`.
    """

    companion: str
    lines: list[LineErrors]
    positions: float | None
    chaotic_from_s: float | None
    angles_rad: float


def with_stated_errors(solution: Kind, run: Program, outcome: RunOutcome, finer: bool) -> Kind:
    """The solution with the errors that a companion states, in `settings["stated_errors"]`, and their warnings.

    Args:
        finer: the companion is finer than the run, not coarser.
    """
    if not is_finished(solution):
        return solution
    try:
        found = state_errors(solution, Companion(run, finer), outcome)
        if found is None and not finer:  # a step of twice the length fails, or the run has one saved state
            found = state_errors(solution, Companion(run, True), outcome)
    except KeyboardInterrupt:  # the run itself is complete
        return solution
    if found is None:
        note = "errors: not stated, because a step of the second run fails"
        return replace(solution, warnings=(*solution.warnings, note))
    warnings = tuple(_warnings(found, solution))
    status = solution.status
    if status == "ok" and solution.scene.run.accuracy is None and _worst(found) > UNUSABLE:
        status = TOO_LONG
    settings = {**solution.settings, "stated_errors": asdict(found)}
    return replace(solution, settings=settings, status=status, warnings=(*solution.warnings, *warnings))


def state_errors(solution: Samples, companion: Companion, outcome: RunOutcome) -> StatedErrors | None:
    """Errors of a run; None if a step of the companion fails, or if a coarser one saves no state."""
    rows = outcome.trajectory
    # every other save of the one with more of them is at the time of a save of the other
    stride = 2 if companion.finer else 1
    every = 2 // stride
    run = rows.r[every - 1 :: every]
    parts = []
    distances = []
    turns = []
    done = 0
    for chunk in companion.chunks(len(rows.r)):
        parts.append(Tensions.of(chunk))
        shared = chunk.r[(stride - 1 - done) % stride :: stride]
        first = done // stride
        difference = np.asarray(shared - run[first : first + len(shared)])
        distances.append(_longest(difference))
        turns.append(_mean_square_turn(solution, difference))
        done += len(chunk.r)
    if done == 0 or done // stride < len(run):
        return None
    of_run = Tensions.of(rows)
    compared = of_run
    if every * len(run) < len(rows.r):  # a coarser companion ends before an odd last save
        compared = Tensions.of(jax.tree.map(lambda array: array[: every * len(run)], rows))
    estimate = error_factor(solution, companion.finer)
    stated = estimate
    if solution.scene.run.accuracy is not None and not companion.finer:
        stated = SCATTER * estimate
    travel = _travel(solution, rows.r)
    chaos = None
    chaotic_from_s = None
    positions = None
    if travel is not None:
        separation = np.concatenate(distances) / travel
        chaos = _start_of_chaos(separation, run)
        positions = stated * float(np.sqrt(np.mean(separation[:chaos] ** 2)))
    factor = stated
    if chaos is not None:
        chaotic_from_s = float(solution.t[every * (1 + chaos)])
        factor = max(stated, 1.0)
    interval = solution.settings["dt"] * solution.settings["save_every"] * every
    return StatedErrors(
        companion=companion.words,
        lines=_line_errors(solution, of_run, _differences(compared, _join_parts(parts)), factor),
        positions=positions,
        chaotic_from_s=chaotic_from_s,
        angles_rad=estimate * _angle_error(solution, np.concatenate(turns)[:chaos], interval),
    )


def error_factor(solution: Samples, finer: bool) -> float:
    """Error of a run over its difference from one that is coarser or finer by as much as a companion."""
    gain = FACTOR
    if "refused_steps" not in solution.settings:
        gain = 2.0 ** INTEGRATORS[solution.scene.run.integrator].order
    if finer:
        return gain / (gain - 1.0)
    return 1.0 / (gain - 1.0)


def _join_parts(parts: list[Tensions]) -> Tensions:
    """The tensions of all parts of a run."""
    samples, means, squares, maxima = map(np.array, zip(*parts, strict=True))
    mean = np.average(means, axis=0, weights=samples)
    square = np.average(squares, axis=0, weights=samples)
    return Tensions(int(np.sum(samples)), mean, square, np.max(maxima, axis=0))


def _differences(run: Tensions, other: Tensions) -> dict[str, np.ndarray]:
    """Differences (n,) [N] of two runs over the same time: of the mean, the deviation and the maximum."""
    return {
        "mean": run.mean - other.mean,
        "deviation": run.deviation - other.deviation,
        "maximum": run.maximum - other.maximum,
    }


def _line_errors(
    solution: Samples, run: Tensions, differences: dict[str, np.ndarray], factor: float
) -> list[LineErrors]:
    """Tensions of each line's most loaded link with their errors, `factor` times the differences."""
    lines = whole_lines(solution.scene)
    links = np.array([line.links.start + int(np.argmax(run.maximum[line.links])) for line in lines])
    size = np.abs(run.mean[links]) + run.deviation[links]
    size = np.maximum(size, max(SMALL_TENSION * float(np.max(run.maximum)), np.finfo(float).tiny))
    values = {"mean": run.mean, "deviation": run.deviation, "maximum": run.maximum}
    errors = {}
    for key, difference in differences.items():
        own = np.abs(difference[links])
        rms = np.array([np.sqrt(np.mean(difference[line.links] ** 2)) for line in lines])
        if key == "maximum":
            errors[key] = np.hypot(own, OTHER_LINKS * rms)
        else:
            # the difference of one link may vanish by chance: it is at least the RMS over the links of its line, and
            # as a fraction of the tension at least the RMS over the lines
            fraction = np.maximum(own, rms) / size
            errors[key] = factor * size * np.maximum(fraction, np.sqrt(np.mean(fraction**2)))
    found = []
    for i, (line, link) in enumerate(zip(lines, links, strict=True)):
        numbers = {f"{key}_n": float(values[key][link]) for key in values}
        numbers |= {f"{key}_error_n": float(errors[key][i]) for key in errors}
        found.append(LineErrors(line.name, int(link) - line.links.start + 1, **numbers))
    return found


def finer_values(run: RunSpec) -> dict[str, float]:
    """Values of a scene whose run is finer by as much as a companion, with twice the saved states."""
    if run.accuracy is None:
        return {"run.dt": 0.5 * run.step}
    return {"run.accuracy": run.accuracy / FACTOR, "run.save_interval": 0.5 * run.interval}


def time_of_divergence(solution: Samples, finer: Samples) -> float | None:
    """Time [s] from which a run and one with `finer_values` are different motions (chaos); None if they are not."""
    count = min(len(solution.t), (len(finer.t) + 1) // 2)
    nodes = solution.positions[1:count]
    if not len(nodes):  # the finer run has one saved state too, if `save_every` exceeds its steps
        return None
    travel = _travel(solution, nodes)
    if travel is None:
        return None
    chaos = _start_of_chaos(_longest(finer.positions[2 : 2 * count : 2] - nodes) / travel, nodes)
    if chaos is None:
        return None
    return float(solution.t[1 + chaos])


def _longest(vectors: Rows) -> np.ndarray:
    """Length (k,) of the longest of vectors (k, nodes, 3)."""
    return np.sqrt(np.max(np.sum(vectors**2, axis=2), axis=1, initial=0.0))


def _travel(solution: Samples, nodes: Rows) -> float | None:
    """Maximum extent [m] of a node's path (k, nodes, 3); None for a run at rest."""
    travel = float(np.max(np.linalg.norm(np.ptp(nodes, axis=0), axis=1)))
    if travel > TRAVEL_AT_REST * max(line.total for line in solution.scene.lines):
        return travel
    return None


def _start_of_chaos(separation: np.ndarray, nodes: Rows) -> int | None:
    """Index of the saved time from which two runs are different motions; None if they are not.

    Small errors then grow at a rate that only chaos has.

    Args:
        separation: distance of the two runs over the travel (k,).
        nodes: positions of one run (k, nodes, 3) [m].
    """
    if not np.any(separation > SEPARATED):
        return None
    shift = _longest(nodes - nodes[0])
    swing = int(np.argmax(shift > 0.5 * np.max(shift)))
    resolved = int(np.argmax(separation > CHAOS_RESOLVED))
    off = int(np.argmax(separation > SEPARATED))
    if resolved > SWINGS * swing and off < SUDDEN * resolved:
        return resolved
    return None


def _mean_square_turn(solution: Samples, difference: np.ndarray) -> np.ndarray:
    """Mean square (k,) [rad^2] over the links of a single line of the bound of their difference of angle; 0 for a
    system of lines.

    The change of a link's vector over its length bounds the change of its angle.

    Args:
        difference: of the positions of the free nodes of both runs (k, nodes, 3) [m].
    """
    line = solution.scene.single_line
    if line is None:
        return np.zeros(len(difference))
    length = line.length
    # the nodes between two fixed end points, or from a fixed one to the free end
    nodes = np.pad(difference, ((0, 0), (1, len(length) - difference.shape[1]), (0, 0)))
    return np.mean(np.sum((np.diff(nodes, axis=1) / length[:, None]) ** 2, axis=2), axis=1)


def _angle_error(solution: Samples, turns: np.ndarray, interval: float) -> float:
    """RMS difference of the links' angles [rad] that arises within a window of a fit, half the shortest link's period.

    Every window of a fit has a start of its own, so that errors of earlier windows do not count: of one that grows
    evenly for a time T the RMS within a window W is `W/T` of that within T.

    Args:
        turns: see `_mean_square_turn`, at times `interval` [s] apart.
    """
    if not len(turns):
        return 0.0
    shortest = min(float(np.min(line.length)) for line in solution.scene.lines)
    window = np.pi * np.sqrt(shortest / GRAVITY) / interval
    return float(np.sqrt(np.mean(turns)) * min(window / len(turns), 1.0))


def _relative(found: StatedErrors) -> Iterator[tuple[str, str, float]]:
    """Line, quantity and relative error: of mean and deviation over their sum, of the maximum over itself."""
    largest = max((row.maximum_n for row in found.lines), default=0.0)
    for row in found.lines:
        scale = max(abs(row.mean_n) + row.deviation_n, SMALL_TENSION * largest)
        if scale > 0.0:
            yield row.line, "mean tension", row.mean_error_n / scale
            yield row.line, "deviation of the tension", row.deviation_error_n / scale
        if row.maximum_n > SMALL_TENSION * largest:
            yield row.line, "largest tension", row.maximum_error_n / row.maximum_n
    if found.positions is not None:
        yield "", "positions", found.positions


def _worst(found: StatedErrors) -> float:
    """The largest relative error that makes equal steps unusable; chance does not."""
    if found.chaotic_from_s is not None:
        return found.positions or 0.0
    return max((size for _, _, size in _relative(found)), default=0.0)


def _warnings(found: StatedErrors, solution: Samples) -> Iterator[str]:
    """One line for the result of each kind that is most off, if it is off by more than the run is to be."""
    accuracy = solution.scene.run.accuracy
    limit = WARNED
    if accuracy is not None:
        limit = MISSED * accuracy
    worst: dict[str, tuple[str, float]] = {}
    for line, what, size in _relative(found):
        is_chance = found.chaotic_from_s is not None and what != "positions"
        if size > limit and not is_chance and size > worst.get(what, ("", 0.0))[1]:
            worst[what] = (line, size)
    for what, (line, size) in worst.items():
        of = f"of {line} " if line else ""
        yield f"{what} {of}may be off by {100.0 * size:.2g} %. {_advice(solution)}"


def _advice(solution: Samples) -> str:
    accuracy = solution.scene.run.accuracy
    if accuracy is not None:
        return f"Use --accuracy {0.25 * accuracy:.2g}"
    if INTEGRATORS[solution.scene.run.integrator]().local_error is None:
        return f"Use --dt {0.5 * solution.settings['dt']:.2g}"
    return "Use --accuracy 0.01 in place of --dt"


def errors_in_words(found: Values) -> str:
    """The stated errors of a solution's settings, in one line."""
    texts = []
    if found["positions"] is not None:
        texts.append(f"positions {100.0 * found['positions']:.2g} % of the travel")
    row = max(found["lines"], key=lambda row: row["maximum_n"], default={"maximum_n": 0.0})
    if row["maximum_n"] > 0.0:
        loads = []
        for key in ("mean", "deviation", "maximum"):
            loads.append(f"{key} {row[f'{key}_n']:.4g} +- {row[f'{key}_error_n']:.2g} N")
        texts.append(f"{row['line']}: {', '.join(loads)}")
    if found["chaotic_from_s"] is not None:
        texts.append(f"chaotic from {found['chaotic_from_s']:.3g} s: positions until then, tensions with their chance")
    return "; ".join([*texts, f"from {found['companion']}"])
