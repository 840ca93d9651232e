"""Multiple shooting: windows joined by weighted gaps, tightened step by step, or closed exactly.

    minimise  1/2 sum |r_k|^2 + 1/2 sum |N' (end_k - start_{k+1})/(w s)|^2,      s = 0.1 rad and 1 rad/s

With small w the sensitivity of a chaotic motion works for the estimate: every window constrains all others. A real
system is never the model, so w (its process noise) is not driven to zero but estimated, by Laplace's approximation of
the evidence, or the gaps are closed exactly by augmented Lagrangian multipliers where the caller asks for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError

from dropper_jax.base.progress import Progress
from fitting.estimate.gaps import Joined, eliminate_joined, gaps, join
from fitting.estimate.gauss_newton import (
    DECREASE_TOLERANCE,
    LARGEST_DAMPING,
    STEP_TOLERANCE,
    Solution,
    closed_starts,
    move,
    nearly_there,
)
from fitting.estimate.normal_equations import Step, data_cost, huber_weights, normal_blocks, prior_terms
from fitting.estimate.simulator import Evaluation, Simulator
from fitting.estimate.windows import Windows

#: Gap weights, one after another. Longer jumps lose the optimum's neighbourhood (measured on the lab dropper).
SCHEDULE = (1.0, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4)
#: Log evidence this near the best is within one standard error of the weight, as a likelihood tells it: of such weights
#: the loosest is taken, with the widest errors. Errors of `dry` on 20 twins of three links with dry joints: 1.04 times
#: those of one uninterrupted run; 1.33 at a difference of 1, 2.6 at 5.
SAME_EVIDENCE = 0.5
#: Less log evidence than the best by this much: it has passed its maximum.
EVIDENCE_DROP = 5.0
#: Gap weight and rounds of the multipliers when gaps are closed exactly.
EXACT_WEIGHT, EXACT_ROUNDS = 1e-3, 4
#: Most evaluations when a joined solution goes on with finer steps.
CONTINUED = 12


class _Level:
    """Cost and steps at one gap weight."""

    def __init__(self, simulator: Simulator, windows: Windows, weight: float, huber: float | None, offset: np.ndarray):
        self.simulator, self.windows, self.weight, self.huber, self.offset = simulator, windows, weight, huber, offset

    def cost(self, evaluation: Evaluation, values: np.ndarray) -> float:
        total = data_cost(evaluation.residual, self.huber) + prior_terms(self.simulator.parameters, values)[0]
        if not np.isfinite(total):
            return np.inf
        value = gaps(self.simulator, self.windows, evaluation, values).value + self.offset
        return total + 0.5 * float(np.sum((value / self.weight) ** 2))

    def system(self, evaluation: Evaluation, values: np.ndarray) -> Joined:
        weights = huber_weights(evaluation.residual, self.huber)
        normal = normal_blocks(evaluation, weights, self.simulator.freedoms)
        return join(normal, gaps(self.simulator, self.windows, evaluation, values), self.weight, self.offset)


def fit_shooting(
    simulator: Simulator,
    windows: Windows,
    begin: Solution,
    *,
    continuity: str = "estimate",
    huber: float | None = None,
    schedule: Sequence[float] = SCHEDULE,
    iterations: int = 12,
    frozen: np.ndarray | None = None,
    finer: Callable[[Windows, Solution], tuple[Windows, Solution] | None] = lambda windows, solution: None,
    progress: Progress | None = None,
) -> tuple[Solution, Windows]:
    """Join the windows of a fit by `fit_windows`, whose noise must be in the windows' weights.

    Args:
        begin: the separate windows' solution.
        continuity: `estimate` stops tightening where the evidence is largest; `tight` goes to the end of the
            schedule; `exact` closes the gaps by multipliers.
        schedule: gap weights.
        iterations: most evaluations at each weight.
        frozen: parameters to hold.
        finer: windows of half the step and the solution on them, or None where the step is fine enough. It is asked
            where a tighter weight has less evidence: a step's own error leaves gaps as a wrong model does, and would
            hold the weight up.

    Returns:
        The solution at the chosen weight (`gap_weight`, `evidence`), and the windows with the substeps it used.
    """
    if not windows.follows.any():
        return begin, windows
    low, high = _limits(simulator, begin.values, frozen)
    count = int(windows.follows.sum()) * simulator.freedoms
    point, total, worse, found = begin, begin.iterations, 0, []
    if continuity == "exact":
        schedule = [w for w in schedule if w > EXACT_WEIGHT] + [EXACT_WEIGHT]
    for i, weight in enumerate(schedule):
        again = windows, point
        while again is not None:
            windows, point = again
            level = _Level(simulator, windows, weight, huber, np.zeros((1, 1)))
            point = _descend(level, point, low, high, iterations, total)
            total = point.iterations
            point.evidence = _evidence(level, point, count)
            if progress:
                text = f"gap weight {weight:g}, {windows.substeps} substeps, evidence {point.evidence:.1f}"
                progress((i + 1) / (len(schedule) + 1), text)
            fell = any(point.evidence < p.evidence - SAME_EVIDENCE for p, _ in found)
            again = finer(windows, point) if fell else None
        found.append((point, windows))
        worse = worse + 1 if point.evidence < max(p.evidence for p, _ in found) - EVIDENCE_DROP else 0
        if continuity == "estimate" and worse == 2:
            break
    best, windows = _loosest(found) if continuity == "estimate" else found[-1]
    if continuity == "exact":
        best = _close(simulator, windows, best, low, high, huber, iterations)
    best.iterations = max(total, best.iterations)
    return best, windows


def joined_step(
    simulator: Simulator, windows: Windows, point: Solution, huber: float | None, low: np.ndarray, high: np.ndarray
) -> Step | None:
    """The full step at a solution's gap weight, moves of the parameters within low and high (k,); None: singular."""
    level = _Level(simulator, windows, point.gap_weight, huber, np.zeros((1, 1)))
    prior = prior_terms(simulator.parameters, point.values)
    return _try(level.system(point.evaluation, point.values), 0.0, prior, low, high)


def continue_shooting(
    simulator: Simulator, windows: Windows, point: Solution, huber: float | None, frozen: np.ndarray | None
) -> Solution:
    """Go on from a joined solution at its gap weight, with its evaluation on other windows, such as of finer steps."""
    low, high = _limits(simulator, point.values, frozen)
    level = _Level(simulator, windows, point.gap_weight, huber, np.zeros((1, 1)))
    return replace(_descend(level, point, low, high, CONTINUED, 0), evidence=point.evidence)


def _loosest(found: list[tuple[Solution, Windows]]) -> tuple[Solution, Windows]:
    """The loosest weight whose evidence is near the best: below it, the noise cannot tell weights apart."""
    most = max(point.evidence for point, _ in found)
    return next((one for one in found if one[0].evidence >= most - SAME_EVIDENCE), found[-1])


def _limits(simulator: Simulator, values: np.ndarray, frozen: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    frozen = np.zeros(len(values), bool) if frozen is None else frozen
    low = np.array([p.low for p in simulator.parameters])
    high = np.array([p.high for p in simulator.parameters])
    return np.where(frozen, values, low), np.where(frozen, values, high)


def _close(simulator, windows, point, low, high, huber, iterations):  # noqa: ANN001, ANN202
    """Rounds of multipliers: y <- y + gap, until the gaps are closed."""
    offset = np.zeros_like(gaps(simulator, windows, point.evaluation, point.values).value)
    for _ in range(EXACT_ROUNDS):
        level = _Level(simulator, windows, EXACT_WEIGHT, huber, offset)
        point = _descend(level, point, low, high, iterations, point.iterations)
        offset = offset + gaps(simulator, windows, point.evaluation, point.values).value
    point.gap_weight = 0.0
    return point


def _evidence(level: _Level, point: Solution, gap_count: int) -> float:
    """Laplace's log evidence of the gap weight w, less constants: -cost - (gaps) log w - log det H / 2."""
    zero = np.zeros(len(point.values))
    system = level.system(point.evaluation, point.values)
    try:
        step = eliminate_joined(system, 0.0, prior_terms(level.simulator.parameters, point.values), zero, zero)
    except LinAlgError:
        return -np.inf
    cost = level.cost(point.evaluation, point.values)
    return -cost - gap_count * float(np.log(level.weight)) - 0.5 * step.log_determinant


def _descend(
    level: _Level, begin: Solution, low: np.ndarray, high: np.ndarray, iterations: int, before: int
) -> Solution:
    """Levenberg-Marquardt at one gap weight."""
    simulator, windows = level.simulator, level.windows
    values, evaluation, starts = begin.values, begin.evaluation, begin.starts
    cost, damping, count = level.cost(evaluation, values), 1e-4, 0
    history, status, message = list(begin.history), "not_converged", f"no convergence at gap weight {level.weight:g}"
    while True:
        prior = prior_terms(simulator.parameters, values)
        system = level.system(evaluation, values)
        step, moved = _try(system, 0.0, prior, low - values, high - values), np.inf
        if step is not None:
            unit = max(2 * data_cost(evaluation.residual, level.huber) / max(windows.samples, 1), 1e-12)
            moved = float(step.dp @ step.information @ step.dp) / unit
            if moved < STEP_TOLERANCE and 2 * step.predicted / unit < DECREASE_TOLERANCE * np.sqrt(windows.samples):
                status, message = "ok", ""
                break
        accepted, near = False, step is not None and nearly_there(moved, 2 * step.predicted / unit, windows.samples)
        while count < iterations and damping < LARGEST_DAMPING:
            step = _try(system, damping, prior, low - values, high - values)
            if step is None:
                damping *= 10
                continue
            trial_values = np.clip(values + step.dp, low, high)
            trial = simulator(trial_values, move(simulator, starts, values, step.dz), windows)
            count += 1
            trial_cost = level.cost(trial, trial_values)
            if trial_cost < cost:
                gain = (cost - trial_cost) / max(step.predicted, 1e-300)
                damping = max(damping * (0.1 if gain > 0.5 else 1.0 if gain > 0.1 else 3.0), 1e-9)
                values, evaluation, cost, accepted = trial_values, trial, trial_cost, True
                starts = closed_starts(evaluation)
                history.append({"cost": cost, "values": values.tolist(), "gap_weight": level.weight})
                break
            if near:  # a smooth cost would have fallen
                break
            damping = max(10 * damping, 1e-3)
        if not accepted:
            if near:
                status = "ok"
                message = f"no step lowers the cost; its model's minimum is {np.sqrt(moved):.2g} standard errors away"
            break
    zero = np.zeros(len(values))
    final = _try(level.system(evaluation, values), 0.0, prior_terms(simulator.parameters, values), zero, zero)
    return Solution(
        values=values,
        starts=starts,
        evaluation=evaluation,
        weights=huber_weights(evaluation.residual, level.huber),
        cost=cost,
        information=begin.information if final is None else final.information,
        gradient=begin.gradient if final is None else final.gradient,
        eliminated=begin.eliminated if final is None else final.eliminated,
        status=status,
        message=message,
        iterations=before + count,
        history=history,
        gap_weight=level.weight,
    )


def _try(system: Joined, damping: float, prior: tuple, low: np.ndarray, high: np.ndarray) -> Step | None:
    try:
        return eliminate_joined(system, damping, prior, low, high)
    except LinAlgError:
        return None
