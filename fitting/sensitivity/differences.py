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

import numpy as np

from dropper_jax.base.progress import Progress, silent
from dropper_jax.quantities.statistics import IN_TIME, NOT_GAUSSIAN, OVER_STEPS, excess_kurtosis
from fitting.parameters.parameter import Parameter
from fitting.sensitivity.problem import Study
from fitting.sensitivity.result import (
    MOTION_GROWTH,
    NOT_RESOLVED,
    OF_RUNS,
    UNCLEAR,
    LocalDerivatives,
    empty_result,
    with_status,
)
from fitting.sensitivity.study_runs import Run, StudyRuns

#: Relative changes of central differences: the slope, and a smaller one whose difference is its error. A farm's runs
#: differ linearly from 0.3 % to 3 % of a current, wave height or EA, but are 20 % off for 1 % of the length of a leg;
#: with 0.3 % and 0.1 % of a length, changes by 0.5 % were off by 2 to 8 errors in 4 of 23 scenes. Below, the rounding
#: of the run dominates: 1 N of a largest tension.
DIFFERENCE_SIZES = (0.01, 0.003)
LENGTH_DIFFERENCE_SIZES = (0.006, 0.002)
#: Relative change up to which static starts are checked for other branches.
START_CHANGE = 0.01
#: Relative change of all parameters of the run that shows noise, and how small differences grow.
SMALL_CHANGE = 1e-6
#: Median of the square of a standard normal number.
MEDIAN_OF_SQUARE = 0.455
#: Error of the steps of a run, over that of its accuracy, above which there is a warning.
MISSED_ACCURACY = 3.0


def difference_sizes(p: Parameter) -> tuple[float, float]:
    """The two relative changes of a parameter."""
    if "length" in p.name.split("."):
        return LENGTH_DIFFERENCE_SIZES
    return DIFFERENCE_SIZES


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


def central_differences(problem: Study, say: Progress = silent) -> LocalDerivatives:
    """Slopes by runs at two sizes: four runs for each parameter, and four in addition.

    A change beyond a bound ends there.
    """
    base = StudyRuns(problem, say)
    if not np.isfinite(base.value):
        return slopes_of_runs(base, [])
    return slopes_of_runs(base, base.run_all(changed_values(problem)))


def slopes_of_runs(base: StudyRuns, runs: Sequence[Run]) -> LocalDerivatives:
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
    found.warnings.extend(statistic_notes(base))
    found.warnings.extend(_unclear_notes(problem, slopes, errors, found.slope_status))
    found.warnings.extend(error_of_value(problem, found))
    if len(found.unclear) == len(slopes):
        found = replace(found, linear_range=0.0)
    return found


def _result_of_value(base: StudyRuns) -> LocalDerivatives:
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


def error_of_value(problem: Study, found: LocalDerivatives) -> list[str]:
    """A line if the steps of the own run are too long for its accuracy."""
    accuracy = problem.scene.run.accuracy
    if accuracy is None or not found.value_error > MISSED_ACCURACY * accuracy * abs(found.value):
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
        checked = START_CHANGE * p.scale
        if reach < checked:
            rate = np.max(changed.at_start[i, 0], where=changed.sides[i, 0], initial=0.0) / reach
            for sign in (-1.0, 1.0):
                values = np.array(problem.values)
                values[i] = np.clip(values[i] + sign * checked, p.low, p.high)
                if base.is_jump(base.start_moved(values), checked, rate):
                    found[i].append(sign * START_CHANGE)
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


def statistic_notes(runs: StudyRuns) -> list[str]:
    """Why a single-step extreme has no slope, and whether the samples are Gaussian as `mpm` assumes."""
    of = runs.problem.of
    if of.statistic in OVER_STEPS:
        stem = of.name.rpartition(".")[0]
        others = " or ".join(f"{stem}.{name}" for name in IN_TIME)
        return [
            f"{of.name}: is the value of a single step, which rounding and every change move to another one. "
            f"Use {others} for slopes"
        ]
    if of.statistic != "mpm":
        return []
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
