"""Joint Gauss-Newton over window starts z_k and shared parameters p, the starts eliminated by a Schur complement.

    minimise  1/2 sum_k |W_k r_k(z_k, p)|^2 + prior,     r_k ~ r_k + Z_k dz_k + P_k dp
    S dp = -g,   S = sum_k P'P - B_k' A_k^-1 B_k,   A_k = Z'Z,  B_k = Z'P       (bounds on p: an exact box problem)
    dz_k = -A_k^-1 (Z'r + B_k dp)

Levenberg-Marquardt scales the diagonals by 1 + damping; Huber's loss enters through weights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import lsq_linear

from fitting.parameters import Parameter
from fitting.simulator import Evaluation, Simulator
from fitting.windows import Starts, Windows

#: Converged when the next step would move the parameters by less than this part of their standard errors (squared).
STEP_TOLERANCE = 1e-4
#: and would lower chi-square by less than this.
DECREASE_TOLERANCE = 1e-2
#: The same for the step that is left where it does not lower the cost: dry friction's switches make the cost rough
#: (measured double pendulum: jumps of 1e-8 to 1e-4 of the cost, steps of 0.015 to 0.083 standard errors left; three
#: links with dry joints: 0.12). As far off as the time step may move the estimate, 0.3 standard errors.
ROUGH_TOLERANCE = 0.3**2
#: Added to the diagonal of a scaled information matrix, the first that makes it positive definite: eliminating starts
#: that a stuck joint leaves undetermined costs digits.
FLOORS = (1e-12, 1e-9, 1e-6, 1e-3, 1.0)
#: Damping beyond which no step is worth trying.
LARGEST_DAMPING = 1e8
#: Largest angle [rad] and rate [rad/s] by which one step may move a start.
LARGEST_MOVE = (0.5, 10.0)


@dataclass
class Solution:
    """Where an estimator ended.

    Attributes:
        values: parameters (k,).
        starts: window starts.
        evaluation: at this point.
        weights: robust weights (K, S, n), 1 without Huber.
        cost: 1/2 chi-square, with prior and gaps.
        information: S (k, k), the inverse of the covariance for noise of deviation sigma.
        eliminated: dz/dp along the optimum of the starts (K, m2, k).
        status: `ok` or `not_converged`; with `message`, which an `ok` fit has where its cost is rough.
        iterations: evaluations made.
        history: one line per iteration: cost, values.
        gap_weight: deviation allowed between windows, in units of their scale; None where they are free.
        step_bias: what the time step moves the parameters (k,) by, in standard errors, to first order.
    """

    values: np.ndarray
    starts: Starts
    evaluation: Evaluation
    weights: np.ndarray
    cost: float
    information: np.ndarray
    gradient: np.ndarray
    eliminated: np.ndarray
    status: str = "not_converged"
    message: str = ""
    iterations: int = 0
    history: list[dict] = field(default_factory=list)
    gap_weight: float | None = None
    evidence: float | None = None
    step_bias: np.ndarray | None = None

    @property
    def chi2(self) -> float:
        """Sum of squared weighted residuals of the measured angles."""
        return float(np.sum(self.weights * self.evaluation.residual**2))


class Normal(NamedTuple):
    """Blocks of the normal equations: A (K, m2, m2), B (K, m2, k), C (k, k), gz (K, m2), gp (k,)."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    gz: np.ndarray
    gp: np.ndarray


def huber_weights(residual: np.ndarray, threshold: float | None) -> np.ndarray:
    """Weights min(1, threshold/|r|) of Huber's loss; 1 without threshold."""
    if threshold is None:
        return np.ones_like(residual)
    return np.minimum(1.0, threshold / np.maximum(np.abs(residual), 1e-300))


def data_cost(residual: np.ndarray, threshold: float | None) -> float:
    """Half chi-square, or Huber's loss `c |r| - c^2/2` beyond the threshold c."""
    if not np.isfinite(residual).all():
        return np.inf
    size = np.abs(residual)
    if threshold is None:
        return 0.5 * float(np.sum(size**2))
    return float(np.sum(np.where(size <= threshold, 0.5 * size**2, threshold * size - 0.5 * threshold**2)))


def prior_terms(parameters: Sequence[Parameter], values: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Cost, gradient (k,) and curvature (k,) of the normal priors."""
    rest = np.array(
        [0.0 if p.prior is None else (v - p.prior[0]) / p.prior[1] for p, v in zip(parameters, values, strict=True)]
    )
    scale = np.array([0.0 if p.prior is None else 1 / p.prior[1] for p in parameters])
    return 0.5 * float(rest @ rest), rest * scale, scale**2


def normal_blocks(evaluation: Evaluation, weights: np.ndarray, m2: int) -> Normal:
    """Normal equations of the measured angles."""
    count = len(evaluation.residual)
    root = np.sqrt(weights).reshape(count, -1)
    r = root * evaluation.residual.reshape(count, -1)
    jacobian = root[..., None] * evaluation.jacobian.reshape(count, r.shape[1], -1)
    square = np.swapaxes(jacobian, 1, 2) @ jacobian
    held = ~jacobian[..., :m2].any(axis=(1, 2))  # a released window; or one without a derivative
    square[:, :m2, :m2] += held[:, None, None] * np.eye(m2)
    slope = np.einsum("kij,ki->kj", jacobian, r)
    return Normal(
        square[:, :m2, :m2], square[:, :m2, m2:], square[:, m2:, m2:].sum(0), slope[:, :m2], slope[:, m2:].sum(0)
    )


class Step(NamedTuple):
    """A proposed step: dp (k,), dz (K, m2), the decrease of the cost it predicts, S, its gradient, dz/dp."""

    dp: np.ndarray
    dz: np.ndarray
    predicted: float
    information: np.ndarray
    gradient: np.ndarray
    eliminated: np.ndarray


def _root(scaled: np.ndarray) -> np.ndarray:
    """Lower Cholesky factor of a matrix with diagonal 1; parameters that cannot be told apart leave a rank short."""
    for floor in FLOORS:
        try:
            return cholesky(scaled + floor * np.eye(len(scaled)), lower=True)
        except LinAlgError:
            continue
    return np.eye(len(scaled))


def bounded_step(information: np.ndarray, gradient: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The dp (k,) in [low, high] that minimises `gradient . dp + dp' information dp/2`; exact, by active sets."""
    if not len(gradient):
        return gradient
    size = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(size, size)
    lower = _root(scaled)
    target = -solve_triangular(lower, gradient * size, lower=True)
    free = cho_solve((lower, True), -gradient * size) * size
    if ((free >= low) & (free <= high)).all():
        return free
    fixed = high - low <= 0
    room = np.where(fixed, 1.0, high)
    found = lsq_linear(
        lower.T[:, ~fixed], target, (low[~fixed] / size[~fixed], room[~fixed] / size[~fixed]), "bvls", tol=1e-14
    )
    step = np.zeros_like(size)
    step[~fixed] = np.clip(found.x * size[~fixed], low[~fixed], high[~fixed])
    return step


def eliminate(normal: Normal, damping: float, prior: tuple, low: np.ndarray, high: np.ndarray) -> Step:
    """One damped step with the window starts eliminated."""
    diagonal = np.einsum("kii->ki", normal.A)
    floor = 1e-12 * diagonal.max() + 1e-300
    A = normal.A + (damping * diagonal + floor)[:, :, None] * np.eye(diagonal.shape[1])
    solved = np.linalg.solve(A, np.concatenate([normal.B, normal.gz[..., None]], axis=2))
    AB, Ag = solved[..., :-1], solved[..., -1]
    curvature = normal.C + np.diag(prior[2])
    information = curvature - np.einsum("kij,kil->jl", normal.B, AB)
    information = 0.5 * (information + information.T)
    gradient = normal.gp + prior[1] - np.einsum("kij,ki->j", normal.B, Ag)
    damped = information + damping * np.diag(np.diag(information))
    dp = bounded_step(damped, gradient, low, high)
    dz = -(Ag + AB @ dp)
    slope = float(normal.gz.ravel() @ dz.ravel() + (normal.gp + prior[1]) @ dp)
    square = (
        np.einsum("ki,kij,kj->", dz, normal.A, dz) + 2 * np.einsum("ki,kij,j->", dz, normal.B, dp) + dp @ curvature @ dp
    )
    return Step(dp, dz, -(slope + 0.5 * float(square)), information, gradient, -AB)


def move(simulator: Simulator, starts: Starts, values: np.ndarray, dz: np.ndarray) -> Starts:
    """Starts after a step in the chart, each window's kept within `LARGEST_MOVE`; not yet closed."""
    from fitting.planar import chart

    bases = chart(simulator.model_at(values), starts.theta)
    m = bases.shape[2]
    most = np.maximum(np.abs(dz[:, :m]).max(1) / LARGEST_MOVE[0], np.abs(dz[:, m:]).max(1) / LARGEST_MOVE[1])
    dz = dz / np.maximum(most, 1.0)[:, None]
    shift = lambda part: np.einsum("kij,kj->ki", bases, part)  # noqa: E731
    return Starts(starts.theta + shift(dz[:, :m]), starts.omega + shift(dz[:, m:]))


def closed_starts(evaluation: Evaluation) -> Starts:
    """The starts as the simulator closed them."""
    n = evaluation.start.shape[1] // 2
    return Starts(evaluation.start[:, :n], evaluation.start[:, n:])


def fit_windows(
    simulator: Simulator,
    windows: Windows,
    values: np.ndarray,
    starts: Starts,
    *,
    huber: float | None = None,
    iterations: int = 40,
    frozen: np.ndarray | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Solution:
    """Fit all window starts and the parameters together.

    Args:
        values: where the parameters start (k,).
        starts: where the windows start.
        huber: threshold of the robust loss in standard deviations; None is least squares.
        frozen: parameters to hold at `values` (k,) bool; they may lie on their bounds.
        progress: called with (fraction, text).

    Returns:
        The best point found; `status` says whether it converged.
    """
    frozen = np.zeros(len(values), bool) if frozen is None else frozen
    low = np.array([p.low for p in simulator.parameters])
    high = np.array([p.high for p in simulator.parameters])
    low, high = np.where(frozen, values, low), np.where(frozen, values, high)
    parameters, m2 = simulator.parameters, simulator.freedoms
    values, damping, history = np.asarray(values, float), 1e-3, []

    def measure(values: np.ndarray, starts: Starts) -> tuple[Evaluation, float]:
        evaluation = simulator(values, starts, windows)
        return evaluation, data_cost(evaluation.residual, huber) + prior_terms(parameters, values)[0]

    evaluation, cost = measure(values, starts)
    count = 1
    status, message = "not_converged", f"no convergence in {iterations} iterations"
    if not np.isfinite(cost):
        message = "the simulation of the start values is not finite"
    while True:
        weights = huber_weights(evaluation.residual, huber)
        normal = normal_blocks(evaluation, weights, m2)
        starts = closed_starts(evaluation)
        if not np.isfinite(cost):
            break
        chi2 = 2 * cost / max(windows.samples, 1)
        history.append({"cost": cost, "values": values.tolist()})
        if progress:
            progress(min(count / iterations, 0.99), f"iteration {count}, chi2 per sample {chi2:.4g}")
        prior = prior_terms(parameters, values)
        newton = eliminate(normal, 0.0, prior, low - values, high - values)
        unit = max(chi2, 1e-12)
        moved = float(newton.dp @ newton.information @ newton.dp) / unit
        if moved < STEP_TOLERANCE and 2 * newton.predicted / unit < DECREASE_TOLERANCE * np.sqrt(windows.samples):
            status, message = "ok", ""
            break
        accepted = False
        while count < iterations and damping < LARGEST_DAMPING:
            step = eliminate(normal, damping, prior, low - values, high - values)
            trial_values = np.clip(values + step.dp, low, high)
            trial, trial_cost = measure(trial_values, move(simulator, starts, values, step.dz))
            count += 1
            gain = (cost - trial_cost) / max(step.predicted, 1e-300)
            if trial_cost < cost:
                damping = max(damping * (0.1 if gain > 0.5 else 1.0 if gain > 0.1 else 3.0), 1e-9)
                values, evaluation, cost, accepted = trial_values, trial, trial_cost, True
                break
            if moved < ROUGH_TOLERANCE:  # this near, a smooth cost would have fallen
                break
            damping = max(10 * damping, 1e-3)
        if not accepted:
            if moved < ROUGH_TOLERANCE or damping >= LARGEST_DAMPING:
                status = "ok" if moved < ROUGH_TOLERANCE else status
                message = f"no step lowers the cost; its model's minimum is {np.sqrt(moved):.2g} standard errors away"
            break
    zero = np.zeros(len(values))
    final = eliminate(normal, 0.0, prior_terms(parameters, values), zero, zero)
    return Solution(
        values=values,
        starts=starts,
        evaluation=evaluation,
        weights=weights,
        cost=cost,
        information=final.information,
        gradient=final.gradient,
        eliminated=final.eliminated,
        status=status,
        message=message,
        iterations=count,
        history=history,
    )


def solve_spd(matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solve with a symmetric positive definite matrix, its diagonal scaled to 1."""
    size = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    factor = cho_factor(matrix * np.outer(size, size) + 1e-13 * np.eye(len(size)))
    scaled = cho_solve(factor, (rhs.T * size).T)
    return (scaled.T * size).T
