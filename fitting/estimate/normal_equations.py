"""Normal equations of all windows: their blocks, elimination of the starts, and a step of the parameters within bounds.

    r_k ~ r_k + Z_k dz_k + P_k dp,      A_k = Z'Z,  B_k = Z'P,  C = sum_k P'P
    S dp = -g,   S = C - sum_k B_k' A_k^-1 B_k       (bounds on p: an exact box problem)
    dz_k = -A_k^-1 (Z'r + B_k dp)

Levenberg-Marquardt scales the diagonals by 1 + damping; a robust loss enters through weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from fitting.estimate.factors import Factor, cholesky_root, scale_diagonal
from fitting.estimate.windows import Starts
from fitting.parameters.parameter import Parameter
from fitting.parameters.rig_priors import CommonPrior


class Evaluation(NamedTuple):
    """All windows at one point; derivatives are by the chart coordinates z (m angles, m rates) and the parameters.

    Attributes:
        theta: simulated angles as the camera sees them (K, S, n) [rad].
        residual: (simulated - measured)/sigma (K, S, n), 0 where there is no sample.
        jacobian: of `residual` (K, S, n, 2 m + k).
        start, end: angles and rates at both ends of each window (K, 2 n).
        start_jacobian, end_jacobian: (K, 2 n, 2 m + k).
        failed: steps above tolerance (K,).
    """

    theta: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    start: np.ndarray
    end: np.ndarray
    start_jacobian: np.ndarray
    end_jacobian: np.ndarray
    failed: np.ndarray

    @property
    def starts(self) -> Starts:
        """The starts after closure by the simulator."""
        n = self.start.shape[1] // 2
        return Starts(self.start[:, :n], self.start[:, n:])


#: Ratio to the median over windows with samples above which a window's derivative counts as undefined. A joint that is
#: just about to stick has no derivative (measured: 1e20), and one such window would block all parameters; chaos reaches
#: 400 at most.
UNDEFINED_RATIO = 1e4


def drop_undefined(e: Evaluation) -> Evaluation:
    """The evaluation, with zero derivative and one more failed step for windows whose derivative is undefined."""
    size = np.abs(e.jacobian).max(axis=(1, 2, 3), initial=0.0)
    moving = size[size > 0]  # windows without samples have no derivative
    typical = 0.0
    if len(moving):
        typical = np.median(moving)
    wild = ~(size <= UNDEFINED_RATIO * max(typical, 1e-300))
    if not wild.any():
        return e
    derivatives = {f: a.copy() for f, a in e._asdict().items() if f.endswith("jacobian")}
    for derivative in derivatives.values():
        derivative[wild] = 0.0
    return e._replace(failed=e.failed + wild, **derivatives)


def move_along(e: Evaluation, dz: np.ndarray) -> Evaluation:
    """The evaluation after a step dz (K, m2) of the starts, by its linear model; derivatives stay."""
    m2 = dz.shape[1]
    return e._replace(
        residual=e.residual + np.einsum("ksnj,kj->ksn", e.jacobian[..., :m2], dz),
        start=e.start + np.einsum("kij,kj->ki", e.start_jacobian[..., :m2], dz),
        end=e.end + np.einsum("kij,kj->ki", e.end_jacobian[..., :m2], dz),
    )


class Normal(NamedTuple):
    """Blocks of the normal equations of K windows, in the symbols of the module.

    Attributes:
        A: by the starts (K, m2, m2).
        B: by starts and parameters (K, m2, k).
        C: by the parameters (k, k).
        gz, gp: gradients of the cost by the starts (K, m2) and by the parameters (k,).
        below: of joined windows the blocks (K - 1, m2, m2) left of the next one's A; None of separate windows.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    gz: np.ndarray
    gp: np.ndarray
    below: np.ndarray | None = None

    def damped(self, damping: np.ndarray | float) -> np.ndarray:
        """The starts' blocks A with their diagonals scaled by 1 + damping, of all or (K, 1), and invertible."""
        diagonal = np.einsum("kii->ki", self.A)
        if self.below is None:
            floor = 1e-12 * diagonal.max(initial=0.0) + 1e-300
        else:
            floor = 1e-13 * diagonal.max()
        return self.A + (damping * diagonal + floor)[:, :, None] * np.eye(diagonal.shape[1])


class Prior(NamedTuple):
    """Cost, gradient (k,) and curvature (k, k) of normal priors."""

    cost: float
    gradient: np.ndarray
    curvature: np.ndarray


def prior_of(parameters: Sequence[Parameter], values: np.ndarray, common: Sequence[CommonPrior]) -> Prior:
    """Contribution of the parameters' priors, single and joint ones, at these values (k,)."""
    mean, sigma = np.array([p.prior or (0.0, np.inf) for p in parameters]).reshape(-1, 2).T
    rest = (values - mean) / sigma
    scale = 1 / sigma
    cost = 0.5 * rest @ rest
    gradient = rest * scale
    curvature = np.diag(scale**2)
    for each in common:
        row = each.share / each.sigma
        off = (each.share @ values - 1) / each.sigma
        cost = cost + 0.5 * off**2
        gradient = gradient + off * row
        curvature = curvature + np.outer(row, row)
    return Prior(cost, gradient, curvature)


def normal_blocks(evaluation: Evaluation, weights: np.ndarray, m2: int) -> Normal:
    """Normal equations of the measured angles."""
    count = len(evaluation.residual)
    root = np.sqrt(weights).reshape(count, -1)
    r = root * evaluation.residual.reshape(count, -1)
    jacobian = root[..., None] * evaluation.jacobian.reshape(count, r.shape[1], -1)
    square = jacobian.mT @ jacobian
    held = ~np.any(jacobian[..., :m2], axis=(1, 2))  # a released window; or one without a derivative
    square[:, :m2, :m2] += held[:, None, None] * np.eye(m2)
    slope = np.einsum("kij,ki->kj", jacobian, r)
    return Normal(
        square[:, :m2, :m2], square[:, :m2, m2:], square[:, m2:, m2:].sum(0), slope[:, :m2], slope[:, m2:].sum(0)
    )


class Gaps(NamedTuple):
    """Gaps between consecutive windows, in the chart of the second one, in units of a gap's scale.

    Attributes:
        left: numbers of the first windows (g,).
        value: end of the first window minus start of the second one (g, m2).
        before, after: derivatives by the starts of the first and of the second window (g, m2, m2).
        shared: derivatives by the parameters (g, m2, k).
    """

    left: np.ndarray
    value: np.ndarray
    before: np.ndarray
    after: np.ndarray
    shared: np.ndarray


def join(normal: Normal, g: Gaps, weight: float) -> Normal:
    """The normal equations with gaps of this weight."""
    A = normal.A.copy()
    B = normal.B.copy()
    gz = normal.gz.copy()
    below = np.zeros((len(A) - 1, *A.shape[1:]))
    value = g.value / weight
    before = g.before / weight
    after = g.after / weight
    shared = g.shared / weight
    right = g.left + 1
    A[g.left] += before.mT @ before
    A[right] += after.mT @ after
    below[g.left] += after.mT @ before
    B[g.left] += before.mT @ shared
    B[right] += after.mT @ shared
    gz[g.left] += np.einsum("gij,gi->gj", before, value)
    gz[right] += np.einsum("gij,gi->gj", after, value)
    C = normal.C + (shared.mT @ shared).sum(0)
    return Normal(A, B, C, gz, normal.gp + np.einsum("gij,gi->j", shared, value), below)


class Step(NamedTuple):
    """A proposed step, and the normal equations of the parameters with the starts eliminated.

    Attributes:
        dp: of the parameters (k,).
        dz: of the starts (K, m2).
        predicted: decrease of the cost by its quadratic model.
        information: S (k, k).
        gradient: of the cost by the parameters (k,), along the optimum of the starts.
        eliminated: dz/dp (K, m2, k).
        log_determinant: of the starts' matrix of joined windows, for their evidence.
    """

    dp: np.ndarray
    dz: np.ndarray
    predicted: float
    information: np.ndarray
    gradient: np.ndarray
    eliminated: np.ndarray
    log_determinant: float = 0.0


def bounded_step(information: np.ndarray, gradient: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The dp (k,) in [low, high] that minimises `gradient . dp + dp' information dp/2`; exact, by active sets."""
    fixed = high - low <= 0
    if fixed.all():
        return np.zeros(len(gradient))
    scaled, size = scale_diagonal(information)
    lower = cholesky_root(scaled)
    target = -solve_triangular(lower, gradient * size, lower=True)
    free = cho_solve((lower, True), -gradient * size) * size
    if ((free >= low) & (free <= high)).all():
        return free
    from scipy.optimize import lsq_linear  # noqa: PLC0415 - slow to import, and few steps reach a bound

    ends = low[~fixed] / size[~fixed], high[~fixed] / size[~fixed]
    found = lsq_linear(lower.T[:, ~fixed], target, ends, "bvls", tol=1e-14)
    step = np.zeros_like(size)
    step[~fixed] = np.clip(found.x * size[~fixed], low[~fixed], high[~fixed])
    return step


def eliminate(normal: Normal, damping: float, prior: Prior, low: np.ndarray, high: np.ndarray) -> Step:
    """One damped step with the window starts eliminated; the parameters change by low to high (k,)."""
    rows = np.concatenate([normal.B, normal.gz[..., None]], axis=2)
    A = normal.damped(damping)
    if normal.below is None:
        factor = None
        solved = np.linalg.solve(A, rows)
    else:
        factor = Factor(A, normal.below)
        solved = factor.solve(rows)
    AB = solved[..., :-1]
    Ag = solved[..., -1]
    information = normal.C + prior.curvature - np.einsum("kij,kil->jl", normal.B, AB)
    information = 0.5 * (information + information.T)
    gradient = normal.gp + prior.gradient - np.einsum("kij,ki->j", normal.B, Ag)
    dp = bounded_step(information + damping * np.diag(np.diag(information)), gradient, low, high)
    dz = -(Ag + AB @ dp)
    slope = normal.gz.ravel() @ dz.ravel() + (normal.gp + prior.gradient) @ dp
    if factor is None:
        square = np.einsum("ki,kij,kj->", dz, normal.A, dz) + 2 * np.einsum("ki,kij,j->", dz, normal.B, dp)
        square = square + dp @ (normal.C + prior.curvature) @ dp
        return Step(dp, dz, -(slope + 0.5 * square), information, gradient, -AB)
    # at the exact minimum of the damped model: decrease = -(slope)/2, plus the part withheld by the damping
    diagonal = np.einsum("kii->ki", normal.A)
    held = damping * (np.sum(diagonal * dz**2) + np.diag(information) @ dp**2)
    return Step(dp, dz, -0.5 * slope + 0.5 * held, information, gradient, -AB, factor.log_determinant)
