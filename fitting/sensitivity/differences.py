"""Slopes of a quantity of runs by central differences at two sizes, with errors that hold.

All runs take the steps of the study's own run and have its phases and seeds: they differ in numbers of the model alone.

    s_1 = (Q(p + h_1) - Q(p - h_1))/(2 h_1)                 slope, h_1 = 1 % of p (0.6 % of a length)
    s_2 = the same with h_2 = 0.3 % (0.2 %)
    error^2 = (s_1 - s_2)^2 + (noise/h_1)^2

Errors hold for changes up to 0.5 %, between both sizes. A run or static start that a change moves much farther than the
opposite or a smaller change does is on another branch, and slopes do not predict changes beyond it.

The noise of Q is what rounding makes of it. The even part `e = (Q(p + h) + Q(p - h))/2 - Q(p)` of a smooth Q goes with
h^2, so that `e_2 - (h_2/h_1)^2 e_1` is noise: a sample for each parameter. One more run, with all parameters changed by
1e-6, gives a sample. Another one, from the study's own start, shows how small differences grow: starts with slack
links are found to 0.3 mm only, from which little is left to grow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.base.parallel_runs import run_parallel
from dropper_jax.model import Model, State
from dropper_jax.run.build import initial_state, stepper_of
from dropper_jax.run.chunks import FACTOR, Companion, Program, compile_run, run_chunks
from dropper_jax.run.quantities import OVER_STEPS, Quantity
from dropper_jax.run.statistics import IN_TIME, NOT_GAUSSIAN, excess_kurtosis
from dropper_jax.scene import RunSpec
from dropper_jax.stepping.progress import Progress as RunProgress
from dropper_jax.stepping.progress import Trajectory, begin
from dropper_jax.stepping.record import Record
from fitting.parameters.parameter import Parameter, with_parameter_values
from fitting.sensitivity.problem import Study, measure_rows
from fitting.sensitivity.result import (
    MOTION_GROWTH,
    NOT_RESOLVED,
    OF_RUNS,
    UNCLEAR,
    Local,
    empty_result,
    with_status,
)

#: Relative changes of central differences: the slope, and a smaller one whose difference is its error. A farm's runs
#: differ linearly from 0.3 % to 3 % of a current, wave height or EA, but are 20 % off for 1 % of the length of a leg;
#: with 0.3 % and 0.1 % of a length, changes by 0.5 % were off by 2 to 8 errors in 4 of 23 scenes. Below, the rounding
#: of the run dominates: 1 N of a largest tension.
DIFFERENCES = (0.01, 0.003)
LENGTH_DIFFERENCES = (0.006, 0.002)
#: Relative change up to which static starts are checked for other branches.
STARTS_CHECKED = 0.01
#: Relative change of all parameters of the run that shows noise, and how small differences grow.
SMALL_CHANGE = 1e-6
#: Displacement by a change, over that by the opposite or a smaller change, each per change, from which a run is on
#: another branch; and the fraction of the motion below which it is not looked at.
JUMP = 6.0
SMALLEST_JUMP = 0.01
#: Median of the square of a standard normal number.
MEDIAN_OF_SQUARE = 0.455
#: Error of the steps of a run, over that of its accuracy, above which there is a warning.
MISSED = 3.0


def difference_sizes(p: Parameter) -> tuple[float, float]:
    """The two relative changes of a parameter."""
    if "length" in p.name.split("."):
        return LENGTH_DIFFERENCES
    return DIFFERENCES


class Run(NamedTuple):
    """A run of a study: the quantity, NaN if a step failed; and the displacement of the farthest node from the study's
    own run, at the start and at the most [m]."""

    value: float
    at_start: float
    at_most: float


def farthest(one: np.ndarray | Array, other: np.ndarray | Array) -> float:
    """Distance [m] of the two positions (..., 3) that are farthest apart."""
    return float(np.linalg.norm(np.asarray(one) - np.asarray(other), axis=-1).max())


def error_by_coarser(of: Quantity, value: float, coarser: float) -> float:
    """The error of a quantity by its value in a run with `FACTOR` times the accuracy; of an extreme the whole
    difference, which depends on few steps."""
    if of.statistic in OVER_STEPS:
        return abs(coarser - value)
    return abs(coarser - value) / (FACTOR - 1.0)


class StudyRuns:
    """Runs of a study along the steps of its own run.

    Attributes:
        start, model, rows: of the study's own run; record: its steps, None if all are equal.
        value, value_error: the quantity of the study's own run, and its error by the steps.
        extent: of the motion of that run [m].
    """

    def __init__(self, problem: Study, say: Progress = silent) -> None:
        self.problem = problem
        self.settings: RunSpec = problem.scene.run
        self.say = say
        start = self.start_at(problem.values)
        if start is None:
            raise SceneError(f"{problem.of.name}: the scene has no start")
        self.start = start
        self.model = self.model_at(problem.values)
        program = self.program(self.model, self.start, None)
        outcome = run_chunks(program, self.settings.rows, lambda share, _: say(0.2 * share, "own run"))
        self.rows: Trajectory = outcome.trajectory
        self.record = _recorded(outcome.carry, problem.of)
        self.value = self.measure(self.model, self.start, self.rows)
        self.extent = farthest(self.rows.r, self.rows.r[0])
        self.value_error = self._error_of_steps(Companion(program, False))

    def _error_of_steps(self, companion: Companion) -> float:
        """The error of the quantity by a run with four times the accuracy; NaN if a step fails, or steps are equal."""
        if self.settings.accuracy is None or not np.isfinite(self.value):
            return np.nan
        pieces = list(companion.chunks(len(self.rows.r)))
        if sum(len(rows.r) for rows in pieces) < len(self.rows.r) // 2 or not pieces:
            return np.nan
        rows = jax.tree.map(lambda *parts: np.concatenate(parts), *pieces)
        return error_by_coarser(self.problem.of, self.value, self.measure(self.model, self.start, rows, 2.0))

    def program(self, model: Model, s: State, record: Record | None) -> Program:
        """The run of a model from a start, along the recorded steps if there are any."""
        settings = self.settings
        if settings.accuracy is None:
            stepper = stepper_of(model, settings)
            return compile_run(stepper, model, begin(stepper, model, s), settings)
        if record is None:
            record = Record.empty(model)
        stepper = stepper_of(model, settings, track_work=False)
        carry = begin(stepper, model, s, follows=True, record=record)
        return compile_run(stepper, model, carry, settings, self.problem.plan.watch(s))

    def model_at(self, values: np.ndarray) -> Model:
        """The model with these values (p,)."""
        problem = self.problem
        return with_parameter_values(problem.model, problem.parameters, jnp.asarray(values, problem.model.dtype))

    def start_at(self, values: np.ndarray) -> State | None:
        """The start with these values, solved from scratch as that of a scene is; None if the scene has none."""
        try:
            return initial_state(self.model_at(values), self.problem.scene.start)
        except SceneError:
            return None

    def start_moved(self, values: np.ndarray) -> float:
        """Displacement [m] of the farthest node at the start with these values; NaN without one."""
        start = self.start_at(values)
        if start is None:
            return np.nan
        return farthest(start.r, self.start.r)

    def is_jump(self, moved: np.ndarray | float, change: np.ndarray | float, rate: np.ndarray | float) -> np.ndarray:
        """Whether changes displace a node much farther than others do at this rate [m per change], if it is known."""
        most = np.maximum(JUMP * np.asarray(rate) * change, SMALLEST_JUMP * self.extent)
        return (np.asarray(rate) > 0.0) & (moved > most)

    def measure(self, model: Model, s: State, rows: Trajectory, intervals: float = 1.0) -> float:
        """The quantity of the rows of a run, NaN if a step failed.

        Args:
            intervals: time between rows, in intervals of the study's own run.
        """
        if rows.first_bad[-1] >= 0:
            return np.nan
        t = s.t + intervals * self.settings.interval * (1.0 + np.arange(len(rows.r)))
        return float(measure_run(self.problem.of, model, s, rows, t, self.problem.plan.watch(s)))

    def run(self, values: np.ndarray) -> Run:
        """The run with these values (p,)."""
        start = self.start_at(values)
        if start is None:
            return Run(np.nan, np.nan, np.nan)
        return self.run_from(start, values)

    def run_from(self, start: State, values: np.ndarray) -> Run:
        """The run with these values (p,) from another start, such as the study's own."""
        model = self.model_at(values)
        program = self.program(model, start, self.record)
        return self.compare(model, start, run_chunks(program, self.settings.rows, silent).trajectory)

    def compare(self, model: Model, s: State, rows: Trajectory) -> Run:
        """The quantity of the rows of a run from s, and its displacements from the study's own."""
        at_most = farthest(rows.r, self.rows.r[: len(rows.r)])
        return Run(self.measure(model, s, rows), farthest(s.r, self.start.r), at_most)

    def run_all(self, values: np.ndarray) -> list[Run]:
        """The runs with these values (cases, p), on all cores at once."""

        def say_done(done: int) -> None:
            self.say(0.2 + 0.8 * done / len(values), f"differences: {done} of {len(values)} runs")

        return run_parallel(self.run, list(values), say_done, alone=0)


def _recorded(carry: RunProgress, of: Quantity) -> Record | None:
    """The steps of a run, for others to repeat; None if all are equal."""
    record = carry.record
    if record is None:
        return None
    if int(record.number) >= len(record.length):
        raise SceneError(f"{of.name}: the run takes more than {len(record.length)} steps. Use a shorter run.duration")
    return record.to_repeat()


measure_run = cached_jit(static=("of",))(measure_rows)


class Differences(NamedTuple):
    """Runs next to the study's own: of each parameter two sizes, of each size two sides (p, 2, 2).

    Attributes:
        change: of the parameter, 0 where a bound allows none.
        value: the quantity.
        at_start, at_most: displacement of the farthest node [m].
        sides: which of them have a run.
    """

    change: np.ndarray
    value: np.ndarray
    at_start: np.ndarray
    at_most: np.ndarray
    sides: np.ndarray

    @classmethod
    def of_runs(cls, problem: Study, runs: Sequence[Run]) -> Differences:
        """The runs (4 p) of `changed_values` but the first."""
        count = len(problem.parameters)
        changes = (changed_values(problem)[1:] - problem.values).reshape(count, 2, 2, count)
        change = np.einsum("pijp->pij", changes)
        value, at_start, at_most = np.reshape(runs, (count, 2, 2, 3)).transpose(3, 0, 1, 2)
        return cls(change, value, at_start, at_most, (change != 0.0) & np.isfinite(value))

    def slopes(self, value: float) -> np.ndarray:
        """Slopes (p, 2) by both sizes: central, or one-sided where one side has no run."""
        rise = np.diff(np.where(self.sides, self.value - value, 0.0))[..., 0]
        change = np.diff(np.where(self.sides, self.change, 0.0))[..., 0]
        return rise / np.where(change == 0.0, np.nan, change)

    def rates(self) -> np.ndarray:
        """Displacement [m] of the farthest node per change of the parameter (p, 2, 2); 0 of sides without a run."""
        size = np.where(self.sides, np.abs(self.change), 1.0)
        return np.where(self.sides, self.at_most, 0.0) / size

    def noise(self, value: float) -> np.ndarray:
        """A sample (p,) of the noise by the even parts of the quantity; 0 of parameters without central differences."""
        same = np.isclose(self.change[..., 0], -self.change[..., 1], rtol=1e-6)
        central = np.all(self.sides.all(axis=2) & same, axis=1)
        ratio = (self.change[central, 1, 1] / self.change[central, 0, 1]) ** 2
        large, small = (0.5 * self.value[central].sum(axis=2) - value).T
        found = np.zeros(len(central))
        found[central] = np.abs(small - ratio * large) / np.sqrt(0.5 + 0.5 * ratio**2 + (1.0 - ratio) ** 2)
        return found


def central_differences(problem: Study, say: Progress = silent) -> Local:
    """Slopes by runs at two sizes: four runs for each parameter, and four in addition.

    A change beyond a bound ends there.
    """
    base = StudyRuns(problem, say)
    if not np.isfinite(base.value):
        return slopes_of_runs(base, [])
    return slopes_of_runs(base, base.run_all(changed_values(problem)))


def slopes_of_runs(base: StudyRuns, runs: Sequence[Run]) -> Local:
    """Slopes by the runs (1 + 4 p) with the values of `changed_values`; none if a step of the own run failed.

    Args:
        base: with the quantity, and its value, that the runs have.
    """
    problem = base.problem
    found = _result_of_value(base)
    if not runs:
        return found
    changed = Differences.of_runs(problem, runs[1:])
    noise = _noise(base.value, runs[0], changed.noise(base.value))
    slopes, errors = _slopes_with_errors(base, changed, noise)
    motion = _motion_growth(base, changed)
    branches = [[] for _ in problem.parameters]
    if motion <= MOTION_GROWTH:  # otherwise every run is on a branch of its own
        branches = _branches(base, changed)
    from_start = base.run_from(base.start, changed_values(problem)[0])
    growth = float(_growth(base.extent, SMALL_CHANGE, from_start.at_start, from_start.at_most))
    found = replace(found, forward=slopes, noise=noise, growth=growth, motion_growth=motion)
    found = with_status(problem, found, errors, np.array(list(map(bool, branches))))
    found.warnings.extend(_branch_notes(problem, branches))
    found.warnings.extend(statistic_notes(problem, base))
    found.warnings.extend(_unclear_notes(problem, slopes, errors, found.slope_status))
    found.warnings.extend(error_of_value(problem, found))
    if len(found.unclear) == len(slopes):
        found = replace(found, linear_range=0.0)
    return found


def _result_of_value(base: StudyRuns) -> Local:
    """The result with the quantity of the study's own run, without slopes."""
    problem = base.problem
    return replace(
        empty_result(problem, base.settings.rows * base.settings.interval),
        value=base.value,
        value_error=base.value_error,
        method=OF_RUNS,
        error=np.full(len(problem.parameters), np.nan),
        noise=0.0,
        growth=0.0,
        motion_growth=0.0,
        linear_range=min(difference_sizes(p)[0] for p in problem.parameters),
    )


def _slopes_with_errors(base: StudyRuns, changed: Differences, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Slopes by the larger changes, and their errors (p,); 0 of parameters that change nothing."""
    slopes, smaller = changed.slopes(base.value).T
    reach = np.abs(changed.change[:, 0]).max(axis=1)
    errors = np.hypot(slopes - smaller, np.maximum(noise, changed.noise(base.value)) / reach)
    idle = [p.is_idle for p in base.problem.parameters]
    still = idle | np.all(changed.value == base.value, axis=(1, 2))
    return np.where(still, 0.0, slopes), np.where(still, 0.0, errors)


def _motion_growth(base: StudyRuns, changed: Differences) -> float:
    """Logarithm of the largest growth of a displacement by the smaller changes."""
    scale = np.array([[p.scale] for p in base.problem.parameters])
    small = np.abs(changed.change[:, 1]) / scale
    growth = _growth(base.extent, small, changed.at_start[:, 1], changed.at_most[:, 1])
    return float(np.max(growth, where=changed.sides[:, 1], initial=0.0))


def _unclear_notes(problem: Study, slopes: np.ndarray, errors: np.ndarray, status: Sequence[str]) -> list[str]:
    """A line on each parameter whose slope is not known to a third."""
    notes = []
    for i, p in enumerate(problem.parameters):
        large, small = (f"{100 * size:g} %" for size in difference_sizes(p))
        differences = f"{problem.of.name}: its differences by {large} and {small} of {p.name}"
        if status[i] == UNCLEAR:
            notes.append(
                f"{differences} give {slopes[i]:.3g} +- {errors[i]:.2g} per unit: it has no slope at this size. Use a "
                "mean, or a sweep over the range"
            )
        if status[i] == NOT_RESOLVED:
            notes.append(
                f"{differences} are apart by more than the whole quantity for 1 %: the slope is not resolved. Use a "
                "sweep over the range, with several seeds"
            )
    return notes


def error_of_value(problem: Study, found: Local) -> list[str]:
    """A line if the steps of the own run are too long for its accuracy."""
    accuracy = problem.scene.run.accuracy
    if accuracy is None or not found.value_error > MISSED * accuracy * abs(found.value):
        return []
    return [
        f"{problem.of.name} may be off by {100.0 * abs(found.value_error / found.value):.2g} %. Use --accuracy "
        f"{0.25 * accuracy:.2g}"
    ]


def changed_values(problem: Study) -> np.ndarray:
    """Values (1 + 4 p, p) of the runs: all changed by little, then four of each parameter, the larger pair first."""
    rows = [problem.values + SMALL_CHANGE * np.array([p.scale for p in problem.parameters])]
    for i, p in enumerate(problem.parameters):
        for size in difference_sizes(p):
            for sign in (-1.0, 1.0):
                row = np.array(problem.values)
                row[i] = np.clip(row[i] + sign * size * p.scale, p.low, p.high)
                rows.append(row)
    return np.array(rows)


def _noise(value: float, slightly_changed: Run, by_samples: np.ndarray) -> float:
    """Standard deviation of the quantity by rounding, a median over the samples of the parameters and one of all."""
    samples = np.append(by_samples[by_samples > 0.0], (slightly_changed.value - value) / np.sqrt(2.0))
    samples = samples[np.isfinite(samples)]
    if not samples.size:
        return np.inf
    return float(np.sqrt(np.median(samples**2) / MEDIAN_OF_SQUARE))


def _growth(
    extent: float, size: np.ndarray | float, at_start: np.ndarray | float, at_most: np.ndarray | float
) -> np.ndarray:
    """Logarithms of displacements by relative changes, over those at the start or the change of the whole motion; 0 of
    those without a run."""
    before = np.fmax(np.fmax(size * extent, at_start), np.finfo(float).tiny)
    return np.log(np.fmax(at_most / before, 1.0))


def _branches(base: StudyRuns, changed: Differences) -> list[list[float]]:
    """Relative changes of each parameter whose run, or static start, is on another branch than the study's own."""
    problem = base.problem
    size = np.abs(changed.change)
    rates = changed.rates()
    smaller = np.zeros_like(rates)
    smaller[:, 0] = rates[:, 1].max(axis=1, keepdims=True)
    jumps = base.is_jump(changed.at_most, size, rates[..., ::-1]) | base.is_jump(changed.at_most, size, smaller)
    found = []
    for i, p in enumerate(problem.parameters):
        found.append(list(changed.change[i][jumps[i] & changed.sides[i]] / p.scale))
        reach = size[i, 0].max()
        checked = STARTS_CHECKED * p.scale
        if reach < checked:
            rate = np.max(changed.at_start[i, 0], where=changed.sides[i, 0], initial=0.0) / reach
            for sign in (-1.0, 1.0):
                values = np.array(problem.values)
                values[i] = np.clip(values[i] + sign * checked, p.low, p.high)
                if base.is_jump(base.start_moved(values), checked, rate):
                    found[i].append(sign * STARTS_CHECKED)
    return found


def _branch_notes(problem: Study, branches: Sequence[Sequence[float]]) -> list[str]:
    """A line on each parameter with a jump of the motion to another branch."""
    notes = []
    for p, shares in zip(problem.parameters, branches, strict=True):
        if shares:
            runs = ", ".join(f"{100.0 * share:+.2g} %" for share in shares)
            notes.append(
                f"{p.name}: the motion or its start at {runs} is on another branch than at the opposite or a smaller "
                "change; a slope holds on one branch only. Use a sweep over the range"
            )
    return notes


def statistic_notes(problem: Study, runs: StudyRuns | None = None) -> list[str]:
    """Why a single-step extreme has no slope, and whether the samples are Gaussian as `mpm` assumes.

    Args:
        runs: of the study, if they are known.
    """
    of = problem.of
    if of.statistic in OVER_STEPS:
        stem = of.name.rpartition(".")[0]
        others = " or ".join(f"{stem}.{name}" for name in IN_TIME)
        return [
            f"{of.name}: is the value of a single step, which rounding and every change move to another one. "
            f"Use {others} for slopes"
        ]
    if of.statistic != "mpm":
        return []
    runs = runs or StudyRuns(problem)
    rows = runs.rows
    t = runs.settings.interval * (1.0 + np.arange(len(rows.r)))
    samples = of.in_time(runs.model, runs.start.r, rows.r, rows.v, rows.tension, t, rows.parted)
    kurtosis = excess_kurtosis(np.asarray(samples))
    if abs(kurtosis) <= NOT_GAUSSIAN:
        return []
    return [
        f"{of.name}: its samples are not Gaussian (excess kurtosis {kurtosis:.2g}), as a most probable maximum from "
        "crossings assumes. Use several seeds and `dropper report`"
    ]
