"""Multiple shooting: windows joined by weighted gaps, tightened step by step, or closed exactly.

    minimise  1/2 sum |r_k|^2 + 1/2 sum |N' (end_k - start_{k+1})/(w s)|^2,      s = 0.1 rad and 1 rad/s

With small w the sensitivity of a chaotic motion works for the estimate: every window constrains all others. A real
system is never the model, so w (its process noise) is not driven to zero but estimated, by Laplace's approximation of
the evidence, or the gaps are closed exactly by augmented Lagrangian multipliers where the caller asks for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from fitting.block_tridiagonal import Factor
from fitting.gauss_newton import (
    DECREASE_TOLERANCE,
    LARGEST_DAMPING,
    ROUGH_TOLERANCE,
    STEP_TOLERANCE,
    Normal,
    Solution,
    bounded_step,
    closed_starts,
    data_cost,
    huber_weights,
    move,
    normal_blocks,
    prior_terms,
)
from fitting.planar import chart, wrap
from fitting.simulator import Evaluation, Simulator
from fitting.windows import Windows

#: Sizes of a gap in angle [rad] and rate [rad/s] that weight 1 allows.
GAP_SCALE = (0.1, 1.0)
#: Gap weights, one after another. Longer jumps lose the optimum's neighbourhood (measured on the lab dropper).
SCHEDULE = (1.0, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4)
#: Differences of log evidence below this say nothing: of such weights the loosest is taken, with the widest errors.
EVIDENCE_DROP = 5.0
#: Gap weight and rounds of the multipliers when gaps are closed exactly.
EXACT_WEIGHT, EXACT_ROUNDS = 1e-3, 4
#: Most evaluations when a joined solution goes on with finer steps.
CONTINUED = 12


class Gaps(NamedTuple):
    """Gaps after windows `left` (g,) in the chart of the next: values (g, m2), derivatives by both windows' z and p."""

    left: np.ndarray
    value: np.ndarray
    before: np.ndarray
    after: np.ndarray
    shared: np.ndarray


def gaps(simulator: Simulator, windows: Windows, evaluation: Evaluation, values: np.ndarray) -> Gaps:
    """Scaled gaps between windows that follow each other."""
    left = np.flatnonzero(windows.follows) - 1
    right = left + 1
    n, m2 = evaluation.start.shape[1] // 2, simulator.freedoms
    basis = chart(simulator.model_at(values), evaluation.start[right, :n])
    m = basis.shape[2]
    rows = np.zeros((len(left), m2, 2 * n))
    rows[:, :m, :n] = np.swapaxes(basis, 1, 2) / GAP_SCALE[0]
    rows[:, m:, n:] = np.swapaxes(basis, 1, 2) / GAP_SCALE[1]
    difference = evaluation.end[left] - evaluation.start[right]
    difference[:, :n] = np.asarray(wrap(difference[:, :n]))
    end, start = rows @ evaluation.end_jacobian[left], rows @ evaluation.start_jacobian[right]
    return Gaps(
        left,
        np.einsum("gij,gj->gi", rows, difference),
        end[..., :m2],
        -start[..., :m2],
        end[..., m2:] - start[..., m2:],
    )


class _System(NamedTuple):
    """Normal equations with gaps: diagonal and neighbouring blocks, border B, C, and slopes."""

    normal: Normal
    below: np.ndarray


def _join(normal: Normal, g: Gaps, weight: float, offset: np.ndarray) -> _System:
    A, B, gz = normal.A.copy(), normal.B.copy(), normal.gz.copy()
    below = np.zeros((len(A) - 1, *A.shape[1:]))
    value, before, after, shared = ((x / weight) for x in (g.value + offset, g.before, g.after, g.shared))
    turn = lambda x: np.swapaxes(x, 1, 2)  # noqa: E731
    right = g.left + 1
    A[g.left] += turn(before) @ before
    A[right] += turn(after) @ after
    below[g.left] += turn(after) @ before
    B[g.left] += turn(before) @ shared
    B[right] += turn(after) @ shared
    gz[g.left] += np.einsum("gij,gi->gj", before, value)
    gz[right] += np.einsum("gij,gi->gj", after, value)
    C = normal.C + (turn(shared) @ shared).sum(0)
    gp = normal.gp + np.einsum("gij,gi->j", shared, value)
    return _System(Normal(A, B, C, gz, gp), below)


class _Step(NamedTuple):
    dp: np.ndarray
    dz: np.ndarray
    predicted: float
    information: np.ndarray
    gradient: np.ndarray
    eliminated: np.ndarray
    log_determinant: float


def _eliminate(system: _System, damping: float, prior: tuple, low: np.ndarray, high: np.ndarray) -> _Step:
    normal = system.normal
    diagonal = np.einsum("kii->ki", normal.A)
    A = normal.A + (damping * diagonal + 1e-13 * diagonal.max())[:, :, None] * np.eye(diagonal.shape[1])
    factor = Factor(A, system.below)
    solved = factor.solve(np.concatenate([normal.B, normal.gz[..., None]], axis=2))
    AB, Ag = solved[..., :-1], solved[..., -1]
    information = normal.C + np.diag(prior[2]) - np.einsum("kij,kil->jl", normal.B, AB)
    information = 0.5 * (information + information.T)
    gradient = normal.gp + prior[1] - np.einsum("kij,ki->j", normal.B, Ag)
    damped = information + damping * np.diag(np.diag(information))
    dp = bounded_step(damped, gradient, low, high)
    dz = -(Ag + AB @ dp)
    slope = float(normal.gz.ravel() @ dz.ravel() + (normal.gp + prior[1]) @ dp)
    # at the exact minimum of the damped model: decrease = -(slope)/2, plus what the damping holds back
    held = damping * (float(np.sum(diagonal * dz**2)) + float(np.diag(information) @ dp**2))
    return _Step(dp, dz, -0.5 * slope + 0.5 * held, information, gradient, -AB, factor.log_determinant)


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

    def system(self, evaluation: Evaluation, values: np.ndarray) -> _System:
        weights = huber_weights(evaluation.residual, self.huber)
        normal = normal_blocks(evaluation, weights, self.simulator.freedoms)
        return _join(normal, gaps(self.simulator, self.windows, evaluation, values), self.weight, self.offset)


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
    progress: Callable[[float, str], None] | None = None,
) -> Solution:
    """Join the windows of a fit by `fit_windows`, whose noise must be in the windows' weights.

    Args:
        begin: the separate windows' solution.
        continuity: `estimate` stops tightening where the evidence is largest; `tight` goes to the end of the
            schedule; `exact` closes the gaps by multipliers.
        schedule: gap weights.
        iterations: most evaluations at each weight.
        frozen: parameters to hold.

    Returns:
        The solution at the chosen weight (`gap_weight`, `evidence`).
    """
    if not windows.follows.any():
        return begin
    low, high = _limits(simulator, begin.values, frozen)
    count = int(windows.follows.sum()) * simulator.freedoms
    point, total, worse, found = begin, begin.iterations, 0, []
    if continuity == "exact":
        schedule = [w for w in schedule if w > EXACT_WEIGHT] + [EXACT_WEIGHT]
    for i, weight in enumerate(schedule):
        level = _Level(simulator, windows, weight, huber, np.zeros((1, 1)))
        point = _descend(level, point, low, high, iterations, total)
        total = point.iterations
        point.evidence = _evidence(level, point, count)
        found.append(point)
        if progress:
            progress((i + 1) / (len(schedule) + 1), f"gap weight {weight:g}, evidence {point.evidence:.1f}")
        worse = worse + 1 if point.evidence < max(p.evidence for p in found) - EVIDENCE_DROP else 0
        if continuity == "estimate" and worse == 2:
            break
    best = _loosest(found) if continuity == "estimate" else found[-1]
    if continuity == "exact":
        best = _close(simulator, windows, best, low, high, huber, iterations)
    best.iterations = max(total, best.iterations)
    return best


def joined_step(
    simulator: Simulator, windows: Windows, point: Solution, huber: float | None, low: np.ndarray, high: np.ndarray
) -> _Step | None:
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


def _loosest(found: list[Solution]) -> Solution:
    """The loosest weight whose evidence is near the best: below it, the noise cannot tell weights apart."""
    most = max(p.evidence for p in found)
    return next((p for p in found if p.evidence >= most - EVIDENCE_DROP), found[-1])


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
        step = _eliminate(system, 0.0, prior_terms(level.simulator.parameters, point.values), zero, zero)
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
        accepted = False
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
            if moved < ROUGH_TOLERANCE:  # this near, a smooth cost would have fallen
                break
            damping = max(10 * damping, 1e-3)
        if not accepted:
            if moved < ROUGH_TOLERANCE:
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


def _try(system: _System, damping: float, prior: tuple, low: np.ndarray, high: np.ndarray) -> _Step | None:
    try:
        return _eliminate(system, damping, prior, low, high)
    except LinAlgError:
        return None
