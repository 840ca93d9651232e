"""The search for a design: linear programmes within a reach that grows where they are accurate.

    min  c.d + P sum s    over  |d| <= reach, g + J d <= 1 - margin + s, s >= 0

If the constraints are nonlinear within the reach, a step d that fails is corrected by a second one: the same programme
with `g(x + d) - J d` for g (Fletcher 1982), so that steps along a limit stay long. A step that lowers the merit
`objective/scale + P sum max(0, g - 1 + margin)` is taken (Fletcher and Sainz de la Maza 1989). Derivatives are those of
steps that are taken. After a round of some steps the windows are chosen again from whole runs, so that the last step of
a round needs no derivatives. A design is accepted if its whole runs meet all constraints, and the search ends with the
best of these.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from dropper_jax.base.errors import Progress, SceneError
from dropper_jax.base.read import Table
from fitting.farm.optimise.design import Design
from fitting.farm.optimise.values import Values
from fitting.farm.optimise.variables import bounds
from fitting.farm.optimise.window_runs import WindowRuns
from fitting.farm.optimise.windows import Window

#: Penalty of a violation, in objectives at the start.
PENALTY_AT_START = 10.0
#: Minimum reach of a step, in ranges of the variables.
SMALLEST_REACH = 2e-3
#: Reach at the start of a round, as a fraction of the first one.
START_REACH_SHARE = 0.25
#: Permitted excess of constraints of the best design over 1: rounding.
PERMITTED_EXCESS = 1e-9
#: Reason why a design is not taken.
FAILED = "steps of a window fail"
#: Difference of windows from whole runs, in limits, above which windows are updated after every step.
MAX_RESIDUAL = 0.02


@dataclass(frozen=True)
class Start:
    """The design at the start (p,): its objective, and its constraints by name, both of whole runs."""

    x: list[float]
    objective: float
    constraints: dict[str, float]


@dataclass
class Search:
    """State of the search; everything that a restart needs.

    Attributes:
        x: the design (p,); `reach`: largest fraction of the ranges by which a step moves it; `round`: rounds done.
        scale: objective at the start.
        best: the best design whose whole runs meet all constraints, and its objective; None before the first one.
        fixed: variables that have been set to a size of their catalogue (p,); `sized`: rounds done by then.
        history: one row per evaluation.
        residual: maximum difference of the last windows' constraints from those of whole runs, in limits, before
            windows and factors were updated; None before the first time. `best_residual`: of the best design.
    """

    x: np.ndarray
    reach: float
    scale: float = 0.0
    round: int = 0
    best: np.ndarray | None = None
    best_objective: float = np.inf
    before: Start | None = None
    fixed: np.ndarray | None = None
    sized: int = 0
    history: list[Table] = field(default_factory=list)
    done: bool = False
    residual: float | None = None
    best_residual: float | None = None


@dataclass(frozen=True)
class Programme:
    """Solution of a linear programme: step (p,), predicted objective and violation."""

    step: np.ndarray
    objective: float
    violation: float


def programme(values: Values, low: np.ndarray, high: np.ndarray, scale: float, limit: float) -> Programme:
    """The linear programme for steps between low and high (p,).

    Raises:
        RuntimeError: it has no solution, which the slack variables rule out.
    """
    from scipy.optimize import linprog  # noqa: PLC0415

    p = len(low)
    m = len(values.value)
    cost = np.concatenate([values.slope[:p] / scale, np.full(m, PENALTY_AT_START)])
    rows = np.hstack([values.slopes[:, :p], -np.eye(m)])
    bounds = [*zip(low, high, strict=True), *[(0.0, None)] * m]
    found = linprog(cost, A_ub=rows, b_ub=limit - values.value, bounds=bounds, method="highs")
    if found.status != 0:
        raise RuntimeError(found.message)
    step = found.x[:p]
    left = np.maximum(values.value + values.slopes[:, :p] @ step - limit, 0.0)
    return Programme(step, values.objective + values.slope[:p] @ step, left.sum())


def violation(values: Values, limit: float) -> float:
    """Total violation of the constraints."""
    return np.sum(np.maximum(values.value - limit, 0.0))


def run_round(
    search: Search, design: Design, windows: tuple[Window, ...], save: Callable[[], None], say: Progress
) -> Values:
    """Steps of one round; the values at its end."""
    settings = design.settings
    say(0.0, f"round {search.round + 1}: derivatives")
    one = _Round(search, design, windows, save, say, design.run_windows(search.x, windows, say))
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
        if last.won < 0.25 * last.gain:  # a step that did not use its full reach would be tried again
            search.reach = 0.4 * min(search.reach, last.size)
        elif last.won > 0.6 * last.gain:
            search.reach = min(search.reach * 1.6, 0.5)
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
        return self.won >= 0.05 * self.gain


@dataclass
class _Round:
    """A round in progress.

    Attributes:
        runs: of the current design; `here`: its values.
        tried: number of steps tried.
    """

    search: Search
    design: Design
    windows: tuple[Window, ...]
    save: Callable[[], None]
    say: Progress
    runs: WindowRuns
    tried: int = 0

    def __post_init__(self) -> None:
        self.here = self.design.values(self.runs)

    def differentiate(self, runs: WindowRuns) -> bool:
        """Make the design of these runs the current one, with its derivatives; False if a shifted run fails."""
        found = self.design.differentiate(runs, self.say)
        if not found.slopes:
            return False
        self.runs = found
        self.here = self.design.values(found)
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
        return 1.0 - self.design.settings.margin

    def merit(self, values: Values) -> float:
        """The objective in those at the start, with penalties for violations."""
        return values.objective / self.search.scale + PENALTY_AT_START * violation(values, self.limit)

    def attempt_corrected(self) -> _Attempt | None:
        """The step of the linear programme, corrected where constraints are curved; None if it predicts no gain."""
        first = self.attempt(self.here)
        if first is None or first.good or first.values is None or violation(first.values, self.limit) == 0.0:
            return first
        seen = first.values.value - self.here.slopes[:, : len(first.step)] @ first.step
        corrected = self.attempt(replace(self.here, value=seen))
        if corrected is None:
            return first
        return replace(corrected, size=first.size)  # the reach follows the step of the programme itself

    def attempt(self, model: Values) -> _Attempt | None:
        """The step of a model's linear programme within the reach, run; None if it predicts no gain."""
        search = self.search
        settings = self.design.settings
        low, high = bounds(self.design.variables)
        span = np.array([v.span for v in self.design.variables])
        reach = search.reach * span
        if search.fixed is not None:
            reach = np.where(search.fixed, 0.0, reach)
        least = np.maximum(low - search.x, -reach)
        most = np.minimum(high - search.x, reach)
        step = programme(model, least, most, search.scale, self.limit)
        merit = self.merit(self.here)
        gain = merit - (step.objective / search.scale + PENALTY_AT_START * step.violation)
        if gain < 1e-4 * settings.enough + 1e-9:
            return None
        self.tried += 1
        x = np.clip(search.x + step.step, low, high)
        size = np.max(np.abs(step.step) / span)
        attempt = _Attempt(x, step.step, size, None, None, gain, -np.inf)
        row = {"round": search.round + 1, "taken": False, "reach": search.reach, "values": x.tolist()}
        runs, failure = _try_design(self.design, x, self.windows, self.say)
        if runs is None:
            row["failure"] = failure
        else:
            found = self.design.values(runs)
            attempt = replace(attempt, runs=runs, values=found, won=merit - self.merit(found))
            row |= {"taken": attempt.good, "objective": found.objective, "worst": found.worst}
            failure = f"objective {found.objective:.5g}, worst {found.worst:.3f}"
        search.history.append(row)
        self.say(min(self.tried / (3 * settings.renew), 1.0), failure)
        self.save()
        return attempt


def _try_design(
    design: Design, x: np.ndarray, windows: tuple[Window, ...], say: Progress
) -> tuple[WindowRuns | None, str]:
    """Windows of a design; None with the reason if it has no equilibrium or they cannot be run."""
    try:
        found = design.run_windows(x, windows, say)
    except SceneError as error:
        return None, str(error)
    if not found.solved:
        return None, FAILED
    return found, ""


def measure(
    search: Search, design: Design, say: Progress, predicted: Values | None = None
) -> tuple[tuple[Window, ...], Values]:
    """Update the windows and compute the constraints by whole runs; the best design so far is stored.

    Args:
        predicted: values of this design with the previous windows and factors, for the residual.
    """
    windows, found = design.measure(search.x, say)
    search.residual = None
    if predicted is not None:
        search.residual = np.max(np.abs(predicted.value - found.value), initial=0.0)
    row = {"round": search.round, "objective": found.objective, "worst": found.worst}
    search.history.append({**row, "whole": True, "residual": search.residual, "values": search.x.tolist()})
    if found.worst <= 1.0 + PERMITTED_EXCESS and found.objective < search.best_objective:
        search.best = search.x.copy()
        search.best_objective = found.objective
        search.best_residual = search.residual
    return windows, found


def snap_to_catalogue(search: Search, design: Design, values: Values) -> np.ndarray:
    """The design with variables on sizes of their catalogues: the neighbours with the lowest cost to first order."""
    x = search.x.copy()
    limit = 1.0 - design.settings.margin
    for k, variable in enumerate(design.variables):
        if variable.catalogue:
            sizes = np.array(variable.sizes(x[k]))
            d = sizes - x[k]
            over = np.maximum(values.value[:, None] + values.slopes[:, k, None] * d - limit, 0.0)
            x[k] = sizes[np.argmin(values.slope[k] * d / search.scale + PENALTY_AT_START * over.sum(axis=0))]
    return x


def run_search(search: Search, design: Design, save: Callable[[], None], say: Progress) -> Start:
    """The whole search, from its current state; returns the design at its start."""
    settings = design.settings
    windows, found = measure(search, design, say)
    start = search.before
    if start is None:
        start = Start(search.x.tolist(), found.objective, constraints_by_name(found))
        search.scale = abs(found.objective) or 1.0
        search.before = start
        save()
    last = search.best_objective
    still_better = True
    while search.round < search.sized + settings.rounds and still_better:
        here = run_round(search, design, windows, save, say)
        search.round += 1
        windows, found = measure(search, design, say, here)
        save()
        # the first design that meets all constraints gains
        gained = last - search.best_objective if np.isfinite(last) else np.inf
        # windows that were off by more than the margin are other ones now, in which steps may be longer again
        movable = search.reach > SMALLEST_REACH or (search.residual or 0.0) > settings.margin
        still_better = here.solved and (gained > settings.enough * search.scale or (found.worst > 1.0 and movable))
        last = search.best_objective
        if search.fixed is None and (not still_better or search.round >= settings.rounds):
            if search.best is not None:
                search.x = search.best.copy()
            if any(v.catalogue for v in design.variables):
                windows = _fix_sizes(search, design, windows, say)
                last = search.best_objective
                still_better = True
                save()
    search.done = True
    save()
    return start


def _fix_sizes(search: Search, design: Design, windows: tuple[Window, ...], say: Progress) -> tuple[Window, ...]:
    """Fix variables on sizes of their catalogues: the others are optimised again, with these windows."""
    say(0.0, "sizes of the catalogues: derivatives")
    runs = design.differentiate(design.run_windows(search.x, windows, say), say)
    search.x = snap_to_catalogue(search, design, design.values(runs))
    search.fixed = np.array([bool(v.catalogue) for v in design.variables])
    search.reach = design.settings.reach
    search.sized = search.round
    search.best = None
    search.best_objective = np.inf
    there, _ = _try_design(design, search.x, windows, say)
    predicted = None if there is None else design.values(there)
    return measure(search, design, say, predicted)[0]


def constraints_by_name(values: Values) -> dict[str, float]:
    """Constraints by name."""
    return dict(zip(values.names, values.value.tolist(), strict=True))
