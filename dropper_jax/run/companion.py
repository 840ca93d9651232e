"""The error of a run, stated from a second run of the same scene.

A run follows an accuracy a or takes equal steps h. Its companion follows 4 a or takes steps 2 h, in half the time.
With errors of order p in h the companion's are g = 2^p times those of the run (4 with an accuracy, to which errors are
proportional), so that the error of a result q is

    e = |q_companion - q|/(g - 1)

With an accuracy, this estimate is the median of the true errors, which scatter in runs that snap. The stated error is
then `SCATTER` times the estimate. The angle error, which fits take as noise, remains the estimate.

To verify a run the companion is finer instead, a/4 or h/2, for two to three times the time, and e = |..| g/(g - 1).
It is finer too if 4 a would exceed 1, the coarsest accuracy.

Results are the mean, the standard deviation and the maximum in time of the tension of each line's most loaded link, and
the positions of the nodes. The maximum depends on few steps and converges irregularly: its error is the whole
difference, and in quadrature half of its RMS over the links of the line. Once both runs are different motions (see
`run.chaos`), their differences are random. Errors of tensions are then the whole differences as well, and positions are
compared until that time.

The compiled program of the run has accuracy, step and count as arguments, so nothing is compiled again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import NamedTuple

import jax
import numpy as np

from dropper_jax.integrators import INTEGRATORS
from dropper_jax.run.chaos import longest, start_of_chaos, travel_of
from dropper_jax.run.chunks import COARSER, FACTOR, FINER, Program, RunOutcome, steps_in_words
from dropper_jax.run.row_store import Rows
from dropper_jax.run.samples import TOO_LONG, Kind, Samples, is_finished
from dropper_jax.run.stated_errors import SMALL_TENSION, LineErrors, StatedErrors, error_warnings
from dropper_jax.scene import RunSpec, whole_lines
from dropper_jax.stepping.progress import Trajectory

#: Stated over estimated error of runs with an accuracy. The true errors of positions in 81 random scenes
#: (`benchmarks/random_scenes.py`, seeds 0 to 99) are at most 1.1 times the estimate in half of them, 3.3 times in 95 %.
SCATTER = 4.0
#: Share of the differences of a line's links in the error of the maximum of its most loaded one, which may vanish by
#: chance: with it true errors are within the stated ones in 95 % of 151 lines of random scenes, without it in 91 %.
OTHER_LINKS = 0.5


class Companion(NamedTuple):
    """The same run from its start with other steps: finer, with two saves for each of the first run, or coarser, with
    one save for two."""

    program: Program
    finer: bool

    @property
    def level(self) -> int:
        """Its level of steps."""
        return FINER if self.finer else COARSER

    def chunks(self, saves: int) -> Iterator[Trajectory]:
        """Its saved states, chunk by chunk, for this number of saves of the first run; ends early if a step fails."""
        left = 2 * saves if self.finer else saves // 2
        carry = self.program.carry
        while left > 0:
            carry, chunk = self.program.advance(carry, left, self.level)
            if carry.has_failed:
                return
            left -= len(chunk.r)
            yield chunk


def with_stated_errors(solution: Kind, run: Program, outcome: RunOutcome, finer: bool) -> Kind:
    """The solution with the errors that a companion states, in `settings["stated_errors"]`, and their warnings.

    Args:
        finer: the companion is finer than the run, not coarser.
    """
    if not is_finished(solution):
        return solution
    accuracy = solution.scene.run.accuracy
    finer = finer or (accuracy is not None and FACTOR * accuracy > 1.0)
    try:
        found = state_errors(solution, Companion(run, finer), outcome)
        if found is None and not finer:  # a step of twice the length fails, or the run has one saved state
            found = state_errors(solution, Companion(run, True), outcome)
    except KeyboardInterrupt:  # the run itself is complete
        return solution
    if found is None:
        note = "errors: not stated, because a step of the second run fails"
        return replace(solution, warnings=(*solution.warnings, note))
    status = solution.status
    if status == "ok" and accuracy is None and found.makes_unusable:
        status = TOO_LONG
    warnings = (*solution.warnings, *error_warnings(found, solution))
    settings = {**solution.settings, "stated_errors": asdict(found)}
    return replace(solution, settings=settings, status=status, warnings=warnings)


def state_errors(solution: Samples, companion: Companion, outcome: RunOutcome) -> StatedErrors | None:
    """Errors of a run; None if a step of the companion fails, or if a coarser one saves no state."""
    rows = outcome.trajectory
    shared = _compare(solution, companion, rows)
    if shared is None:
        return None
    estimate = error_factor(solution, companion.finer)
    stated = estimate
    if solution.scene.run.accuracy is not None and not companion.finer:
        stated = SCATTER * estimate
    travel = travel_of(solution, rows.r)
    chaos = None
    chaotic_from_s = None
    positions = None
    if travel is not None:
        separation = shared.distances / travel
        chaos = start_of_chaos(separation, shared.nodes)
        positions = stated * float(np.sqrt(np.mean(separation[:chaos] ** 2)))
    factor = stated
    if chaos is not None:
        chaotic_from_s = float(solution.t[shared.every * (1 + chaos)])
        factor = max(stated, 1.0)
    interval = solution.settings["dt"] * solution.settings["save_every"] * shared.every
    return StatedErrors(
        companion=steps_in_words(companion.program.run, companion.level),
        lines=_line_errors(solution, Tensions.of(rows), shared.difference, factor),
        positions=positions,
        chaotic_from_s=chaotic_from_s,
        angles_rad=estimate * _angle_error(solution, shared.turns[:chaos], interval),
    )


def error_factor(solution: Samples, finer: bool) -> float:
    """Error of a run over its difference from one that is coarser or finer by as much as a companion."""
    gain = FACTOR
    if "refused_steps" not in solution.settings:
        gain = 2.0 ** INTEGRATORS[solution.scene.run.integrator].order
    if finer:
        return gain / (gain - 1.0)
    return 1.0 / (gain - 1.0)


def finer_values(run: RunSpec) -> dict[str, float]:
    """Values of a scene whose run is finer by as much as a companion, with twice the saved states."""
    if run.accuracy is None:
        return {"run.dt": 0.5 * run.step}
    return {"run.accuracy": run.accuracy / FACTOR, "run.save_interval": 0.5 * run.interval}


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

    @classmethod
    def join(cls, parts: list[Tensions]) -> Tensions:
        """The tensions of all parts of a run."""
        samples, means, squares, maxima = map(np.array, zip(*parts, strict=True))
        mean = np.average(means, axis=0, weights=samples)
        square = np.average(squares, axis=0, weights=samples)
        return cls(int(np.sum(samples)), mean, square, np.max(maxima, axis=0))

    def statistics(self) -> dict[str, np.ndarray]:
        """Mean, standard deviation and maximum in time (n,) [N]."""
        deviation = np.sqrt(np.maximum(self.square - self.mean**2, 0.0))
        return {"mean": self.mean, "deviation": deviation, "maximum": self.maximum}


class SharedSaves(NamedTuple):
    """A run and its companion at their k common times.

    Attributes:
        every: common times are those of every `every`-th save of the run.
        nodes: free nodes of the run (k, nodes, 3) [m].
        distances: of the nodes of both that are farthest apart (k,) [m].
        turns: see `_mean_square_turn` (k,) [rad^2].
        difference: of the statistics of the tensions (n,) [N], the run's less the companion's.
    """

    every: int
    nodes: Rows
    distances: np.ndarray
    turns: np.ndarray
    difference: dict[str, np.ndarray]


def _compare(solution: Samples, companion: Companion, rows: Trajectory) -> SharedSaves | None:
    """The run and its companion at their common times; None if a step of the companion fails."""
    # every other save of the one with more of them is at the time of a save of the other
    stride = 2 if companion.finer else 1
    every = 2 // stride
    nodes = rows.r[every - 1 :: every]
    parts = []
    distances = []
    turns = []
    done = 0
    for chunk in companion.chunks(len(rows.r)):
        parts.append(Tensions.of(chunk))
        shared = chunk.r[(stride - 1 - done) % stride :: stride]
        first = done // stride
        apart = np.asarray(shared - nodes[first : first + len(shared)])
        distances.append(longest(apart))
        turns.append(_mean_square_turn(solution, apart))
        done += len(chunk.r)
    if done == 0 or done // stride < len(nodes):
        return None
    covered = every * len(nodes)  # a coarser companion ends before an odd last save
    of_run = Tensions.of(jax.tree.map(lambda array: array[:covered], rows)).statistics()
    other = Tensions.join(parts).statistics()
    difference = {key: of_run[key] - other[key] for key in of_run}
    return SharedSaves(every, nodes, np.concatenate(distances), np.concatenate(turns), difference)


def _line_errors(
    solution: Samples, run: Tensions, difference: dict[str, np.ndarray], factor: float
) -> list[LineErrors]:
    """Tensions of each line's most loaded link with their errors, `factor` times the differences (n,)."""
    lines = whole_lines(solution.scene)
    links = np.array([line.links.start + int(np.argmax(run.maximum[line.links])) for line in lines])
    values = run.statistics()
    size = np.abs(values["mean"][links]) + values["deviation"][links]
    size = np.maximum(size, max(SMALL_TENSION * float(np.max(run.maximum)), np.finfo(float).tiny))
    columns = {}
    for key, apart in difference.items():
        own = np.abs(apart[links])
        rms = np.array([np.sqrt(np.mean(apart[line.links] ** 2)) for line in lines])
        if key == "maximum":
            error = np.hypot(own, OTHER_LINKS * rms)
        else:
            # the difference of one link may vanish by chance: it is at least the RMS over the links of its line, and
            # as a fraction of the tension at least the RMS over the lines
            fraction = np.maximum(own, rms) / size
            error = factor * size * np.maximum(fraction, np.sqrt(np.mean(fraction**2)))
        columns |= {f"{key}_n": values[key][links], f"{key}_error_n": error}
    found = []
    for i, line in enumerate(lines):
        numbers = {key: float(column[i]) for key, column in columns.items()}
        found.append(LineErrors(line.name, int(links[i]) - line.links.start + 1, **numbers))
    return found


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
    evenly for a time T the RMS within a window W is `W/T` of that within T. Without gravity the window is the run.

    Args:
        turns: see `_mean_square_turn`, at times `interval` [s] apart.
    """
    if not len(turns):
        return 0.0
    shortest = min(float(np.min(line.length)) for line in solution.scene.lines)
    gravity = solution.scene.gravity
    share = 1.0
    if gravity > 0.0:
        window = np.pi * np.sqrt(shortest / gravity) / interval
        share = min(window / len(turns), 1.0)
    return float(np.sqrt(np.mean(turns)) * share)
