"""A round of the search: steps of a design by linear programmes, with windows that stay the same.

    min  c.d + P sum s    over  |d| <= reach, g + J d <= 1 - margin + s, s >= 0

If the constraints are nonlinear within the reach, a step d that fails is corrected by a second one: the same programme
with `g(x + d) - J d` for g (Fletcher 1982), so that steps along a limit stay long. A step that lowers the merit
`objective/scale + P sum max(0, g - 1 + margin)` is taken (Fletcher and Sainz de la Maza 1989). Derivatives are those of
steps that are taken: the last step of a round needs none, because the windows are chosen again after it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress
from fitting.farm.optimise.design_problem import DesignProblem
from fitting.farm.optimise.programme import PENALTY_AT_START, solve_programme, total_violation
from fitting.farm.optimise.search_state import Search
from fitting.farm.optimise.values import Values
from fitting.farm.optimise.variables import bounds
from fitting.farm.optimise.windows import Window, WindowRuns

#: Minimum reach of a step, in ranges of the variables.
SMALLEST_REACH = 2e-3
#: Reach at the start of a round, as a fraction of the first one.
START_REACH_SHARE = 0.25
#: Reason why a design is not taken.
FAILED = "steps of a window fail"
#: Difference of windows from whole runs, in limits, above which windows are updated after every step.
MAX_RESIDUAL = 0.02
#: Fractions of the predicted gain: below the first a step is not taken, below the second the reach becomes smaller,
#: above the third it grows.
TAKEN_SHARE = 0.05
POOR_SHARE = 0.25
GOOD_SHARE = 0.6
#: Factors by which the reach becomes smaller or grows, and its maximum, in ranges of the variables.
SMALLER_REACH = 0.4
LARGER_REACH = 1.6
LARGEST_REACH = 0.5


def run_round(
    search: Search, problem: DesignProblem, windows: tuple[Window, ...], save: Callable[[], None], say: Progress
) -> Values:
    """Steps of one round; the values at its end."""
    settings = problem.settings
    say(0.0, f"round {search.round + 1}: derivatives")
    one = _Round(search, problem, windows, save, say, problem.storm_runs.run_windows(search.x, windows, say))
    if not one.differentiate(one.runs):
        return replace(one.here, solved=False)
    renew = settings.renew if (search.residual or 0.0) <= MAX_RESIDUAL else 1
    search.reach = max(search.reach, START_REACH_SHARE * settings.reach)
    taken = 0
    while taken < renew and one.tried < 3 * settings.renew and search.reach > SMALLEST_REACH:
        last = one.attempt_corrected()
        if last is None:
            break
        if last.good and one.take(last, differentiate=taken + 1 < renew):
            taken += 1
        elif last.good:
            last = replace(last, won=-np.inf)
        if last.won < POOR_SHARE * last.gain:  # a step that did not use its full reach would be tried again
            search.reach = SMALLER_REACH * min(search.reach, last.size)
        elif last.won > GOOD_SHARE * last.gain:
            search.reach = min(search.reach * LARGER_REACH, LARGEST_REACH)
        save()
    return one.here


@dataclass(frozen=True)
class _Attempt:
    """A design that was tried: its step (p,), maximum fraction of the ranges, predicted and true gain of merit."""

    x: np.ndarray
    step: np.ndarray
    size: float
    runs: WindowRuns | None
    values: Values | None
    gain: float
    won: float

    @property
    def good(self) -> bool:
        """Whether enough of the predicted gain is true, so that the step is taken."""
        return self.won >= TAKEN_SHARE * self.gain


@dataclass
class _Round:
    """A round in progress.

    Attributes:
        runs: of the current design; `here`: its values.
        tried: number of steps tried.
    """

    search: Search
    problem: DesignProblem
    windows: tuple[Window, ...]
    save: Callable[[], None]
    say: Progress
    runs: WindowRuns
    tried: int = 0

    def __post_init__(self) -> None:
        self.here = self.problem.values(self.runs)

    def differentiate(self, runs: WindowRuns) -> bool:
        """Make the design of these runs the current one, with its derivatives; False if a shifted run fails."""
        found = self.problem.storm_runs.differentiate(runs, self.say)
        if not found.slopes:
            return False
        self.runs = found
        self.here = self.problem.values(found)
        return True

    def take(self, step: _Attempt, differentiate: bool) -> bool:
        """Make the design of a good step the current one; False if derivatives are wanted and a shifted run fails."""
        if step.runs is None or step.values is None:
            raise ValueError("a step whose windows failed is not good")
        if not differentiate:
            self.runs = step.runs
            self.here = step.values
        elif not self.differentiate(step.runs):
            self.search.history[-1] |= {"taken": False, "failure": FAILED}
            return False
        self.search.x = step.x
        return True

    @property
    def limit(self) -> float:
        """Upper limit of the constraints."""
        return 1.0 - self.problem.settings.margin

    def merit(self, values: Values) -> float:
        """The objective in those at the start, with penalties for violations."""
        return values.objective / self.search.scale + PENALTY_AT_START * total_violation(values, self.limit)

    def attempt_corrected(self) -> _Attempt | None:
        """The step of the linear programme, corrected where constraints are curved; None if it predicts no gain."""
        first = self.attempt(self.here)
        if first is None or first.good or first.values is None or total_violation(first.values, self.limit) == 0.0:
            return first
        seen = first.values.value - self.here.slopes[:, : len(first.step)] @ first.step
        corrected = self.attempt(replace(self.here, value=seen))
        if corrected is None:
            return first
        return replace(corrected, size=first.size)  # the reach follows the step of the programme itself

    def attempt(self, model: Values) -> _Attempt | None:
        """The step of a model's linear programme within the reach, run; None if it predicts no gain."""
        search = self.search
        settings = self.problem.settings
        low, high = bounds(self.problem.variables)
        span = np.array([v.span for v in self.problem.variables])
        reach = search.reach * span
        if search.fixed is not None:
            reach = np.where(search.fixed, 0.0, reach)
        least = np.maximum(low - search.x, -reach)
        most = np.minimum(high - search.x, reach)
        step = solve_programme(model, least, most, search.scale, self.limit)
        merit = self.merit(self.here)
        gain = merit - (step.objective / search.scale + PENALTY_AT_START * step.violation)
        if gain < 1e-4 * settings.enough + 1e-9:
            return None
        self.tried += 1
        x = np.clip(search.x + step.step, low, high)
        attempt = _Attempt(x, step.step, np.max(np.abs(step.step) / span), None, None, gain, -np.inf)
        row = {"round": search.round + 1, "taken": False, "reach": search.reach, "values": x.tolist()}
        runs, failure = try_design(self.problem, x, self.windows, self.say)
        if runs is None:
            row["failure"] = failure
        else:
            found = self.problem.values(runs)
            attempt = replace(attempt, runs=runs, values=found, won=merit - self.merit(found))
            row |= {"taken": attempt.good, "objective": found.objective, "worst": found.worst}
            failure = f"objective {found.objective:.5g}, worst {found.worst:.3f}"
        search.history.append(row)
        self.say(min(self.tried / (3 * settings.renew), 1.0), failure)
        self.save()
        return attempt


def try_design(
    problem: DesignProblem, x: np.ndarray, windows: tuple[Window, ...], say: Progress
) -> tuple[WindowRuns | None, str]:
    """Windows of a design; None with the reason if it has no equilibrium or they cannot be run."""
    try:
        found = problem.storm_runs.run_windows(x, windows, say)
    except SceneError as error:
        return None, str(error)
    if not found.solved:
        return None, FAILED
    return found, ""
