"""How well a law predicts stretches that were not fitted: cross-validation in blocks of windows.

A block of neighbouring windows is left out, with one window on either side of it. The optimal parameters of the other
windows follow to first order from their normal equations at the law's own optimum,

    dp = argmin g . dp + dp' S dp/2  inside the bounds,     S, g: sums over the other windows.

The start of each window left out is fitted to the first third of its samples, and the rest is scored. With r the
residuals after both moves, and C the covariance of start and parameters given all data used,

    log p = -1/2 (r' V^-1 r + log det V),     V = 1 + W C W',     W: derivatives of r by start and parameters,

in units of the noise. Nothing is simulated again. (Bernardo and Smith 1994, log scores; Burman, Chow and Nolan 1994,
blocks with gaps between them.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fitting.estimate.blocks import residual_scores
from fitting.estimate.factors import scale_diagonal
from fitting.estimate.normal_equations import bounded_step
from fitting.estimate.solution import Solution

#: Maximum number of blocks.
MOST_BLOCKS = 5
#: Minimum number of windows per block.
FEWEST_WINDOWS = 3
#: Number of windows that are neither scored nor fitted, on either side of a block.
GAP_WINDOWS = 1

#: Fraction of a predicted window whose samples determine its start; the others are scored.
START_FRACTION = 1 / 3

#: The windows that a fold scores and those that it fits, (K,) bool each.
Fold = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Scores:
    """Scores of K predicted windows.

    Attributes:
        log_score: log density of the scored samples minus that of the noise alone (K,); 0 where nothing was scored.
        square: sum of squared angle errors (K,) [rad^2].
        count: samples scored (K,).
    """

    log_score: np.ndarray
    square: np.ndarray
    count: np.ndarray

    @property
    def rms(self) -> float:
        """RMS angle error [rad]."""
        return np.sqrt(self.square.sum() / max(self.count.sum(), 1))


def blocks(run: np.ndarray) -> list[Fold]:
    """The windows that each fold scores and fits, (K,) bool each, from the windows' runs (K,)."""
    count = len(run)
    number = min(MOST_BLOCKS, max(count // FEWEST_WINDOWS, min(count, 2), 1))
    gap = GAP_WINDOWS if count >= 2 * FEWEST_WINDOWS else 0
    index = np.arange(count)
    near = (np.abs(index[:, None] - index) <= gap) & (run[:, None] == run)
    folds = []
    for block in np.array_split(index, number):
        used = ~near[block].any(axis=0)
        if used.any():
            folds.append((np.isin(index, block), used))
    return folds


def last_third(begin: np.ndarray, run: np.ndarray) -> list[Fold]:
    """Folds that score the last third of every run, predicted from all before it."""
    scored, used = np.zeros((2, len(run)), bool)
    for r in np.unique(run):
        mine = np.flatnonzero(run == r)
        mine = mine[np.argsort(begin[mine])]
        first = max(1, len(mine) - max(1, len(mine) // 3))
        scored[mine[first:]] = True
        used[mine[: max(first - GAP_WINDOWS, 1)]] = True
    if scored.any() and used.any():
        return [(scored, used)]
    return []


def other_runs(run: np.ndarray) -> list[Fold]:
    """Folds that score every run from the others; empty if there is only one run."""
    runs = np.unique(run)
    if len(runs) > 1:
        return [(run == r, run != r) for r in runs]
    return []


def with_released_fitted(folds: list[Fold], released: np.ndarray) -> list[Fold]:
    """The folds with windows that start from the model (K,) always fitted: only they determine the release time."""
    return [(scored & ~released, used | released) for scored, used in folds]


def score(solution: Solution, folds: list[Fold]) -> Scores:
    """Predictions of the windows that the folds score, from the windows that each fits."""
    e = solution.evaluation
    windows = solution.windows
    m2 = solution.problem.freedoms
    free = solution.free
    prior = solution.problem.prior(solution.values)
    low, high = solution.problem.step_bounds(solution.values)
    columns = np.concatenate([np.arange(m2), m2 + free])
    jacobian = e.jacobian[..., columns]
    along = residual_scores(e, solution)[..., free]
    information = np.einsum("ksni,ksnj->kij", along, along, optimize=True)
    gradient = np.einsum("ksni,ksn->ki", along, e.residual, optimize=True)
    early = windows.known & (windows.elapsed <= START_FRACTION)[:, :, None]
    late = windows.known & ~early
    found = np.zeros((3, windows.count))
    for scored, used in folds:
        S = information[used].sum(0) + prior.curvature[np.ix_(free, free)]
        dp = bounded_step(S, gradient[used].sum(0) + prior.gradient[free], low[free], high[free])
        for k in np.flatnonzero(scored & late.any(axis=(1, 2))):
            found[:, k] = score_window(e.residual[k], jacobian[k], early[k], late[k], S, dp, windows.weight[k], m2)
    return Scores(*found)


#: Value added to the diagonal of a start's scaled precision: few samples leave some directions open.
DIAGONAL_FLOOR = 1e-12


def score_window(
    residual: np.ndarray,
    jacobian: np.ndarray,
    early: np.ndarray,
    late: np.ndarray,
    S: np.ndarray,
    dp: np.ndarray,
    weight: np.ndarray,
    m2: int,
) -> tuple[float, float, int]:
    """Log score, sum of squared errors [rad^2] and samples of one window (S, n); parameters: `dp` +- S^-1."""
    moved = residual + jacobian[..., m2:] @ dp
    A = jacobian[early]
    r = moved[early]
    precision = A.T @ A
    precision[m2:, m2:] += S
    # rows and columns in units in which the diagonal is 1
    before, size = scale_diagonal(precision)
    before = before + DIAGONAL_FLOOR * np.eye(len(size))
    W = jacobian[late] * size
    after = before + W.T @ W
    left = moved[late] - W @ np.linalg.solve(before, (A.T @ r) * size)
    slope = W.T @ left
    square = left @ left - slope @ np.linalg.solve(after, slope)
    volume = np.linalg.slogdet(after)[1] - np.linalg.slogdet(before)[1]
    errors = left / weight[late]
    return -0.5 * (square + volume), errors @ errors, int(late.sum())
