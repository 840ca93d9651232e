"""Scatter of blocks of scores: errors of estimates whose model is partly wrong, not from the noise's size.

Let g_b be the contribution of a stretch of time to the parameters' gradient, with its window starts eliminated, and S_b
its contribution to the information S. Both include the gaps of joined windows, each counted with the next window.
Leaving the block out moves the estimate by `d_b = (S - S_b)^-1 g_b` to first order, and

    cov = (B - 1)/B sum_b (d_b - mean d)(d_b - mean d)'        (jackknife over blocks: Tukey 1958, Kuensch 1989)

holds for any residuals, as long as blocks are independent: each is at least two correlation times of the scores long.
Priors count as separate measurements.

A wrong model has no single best value: it changes with the amplitude, of which each block sees only a part. Let d be
the difference between the estimates from the first and the second half of the time. The variance grows by the larger of
`d^2/4` (the distance of each half from the whole) and `d^2 - 4 var` (the excess over independent blocks).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fitting.estimate.factors import invert_spd, scale_diagonal, solve_spd
from fitting.estimate.normal_equations import Evaluation, Step
from fitting.estimate.solution import Solution

#: Minimum number of blocks, for any memory of the scores.
FEWEST_BLOCKS = 4


class TimePieces(NamedTuple):
    """Gradients (P, k) and information (P, k, k) of pieces of time, in the order of their runs (P,)."""

    gradient: np.ndarray
    information: np.ndarray
    run: np.ndarray


def residual_scores(evaluation: Evaluation, step: Step | Solution) -> np.ndarray:
    """Derivative of every residual by the parameters along the optimum of the starts (K, S, n, k)."""
    m2 = step.eliminated.shape[1]
    jacobian = evaluation.jacobian
    return jacobian[..., m2:] + np.einsum("ksnj,kjp->ksnp", jacobian[..., :m2], step.eliminated)


#: Target number of pieces of time; a small number of windows is cut into them.
TARGET_PIECES = 60
#: Factor of a run's number in the number of a piece: more pieces than any run has.
MOST_PIECES = 10**9


class Contributions(NamedTuple):
    """Contributions to the gradient (N, k) and the information (N, k, k) at times (N,) [s] of runs (N,)."""

    t: np.ndarray
    run: np.ndarray
    gradient: np.ndarray
    information: np.ndarray


def _sample_scores(solution: Solution, free: np.ndarray) -> Contributions:
    """Contributions of the frames with samples."""
    timing = solution.problem.timing()
    known = timing.known
    weights = solution.weights
    score = residual_scores(solution.evaluation, solution)[..., free]
    gradient = np.einsum("ksnp,ksn->ksp", score, weights * solution.evaluation.residual)
    information = np.einsum("ksnp,ksn,ksnq->kspq", score, weights, score, optimize=True)
    return Contributions(timing.t[known], timing.run[known], gradient[known], information[known])


def _gap_scores(solution: Solution, free: np.ndarray, weight: float) -> Contributions:
    """Contributions of the gaps with this weight, each at the start of the next window."""
    windows = solution.windows
    gaps = solution.problem.gaps(solution.evaluation, solution.values)
    right = gaps.left + 1
    along = solution.eliminated
    slope = (gaps.shared + gaps.before @ along[gaps.left] + gaps.after @ along[right])[..., free] / weight
    gradient = np.einsum("gip,gi->gp", slope, gaps.value / weight)
    return Contributions(windows.begin[right], windows.run[right], gradient, np.einsum("gip,giq->gpq", slope, slope))


def time_pieces(solution: Solution, free: np.ndarray) -> TimePieces:
    """Parts of the gradient and the information of the free parameters (their numbers), of equal duration."""
    timing = solution.problem.timing()
    scores = _sample_scores(solution, free)
    if solution.gap_weight and solution.windows.follows.any():
        gaps = _gap_scores(solution, free, solution.gap_weight)
        scores = Contributions(*map(np.concatenate, zip(scores, gaps, strict=True)))
    duration = timing.duration / max(TARGET_PIECES, timing.blocks) * (1 + 1e-9)
    piece = np.floor((scores.t - timing.begin[scores.run]) / duration + 1e-6).astype(int)
    # run and piece as one number
    numbers, index = np.unique(scores.run * MOST_PIECES + np.maximum(piece, 0), return_inverse=True)
    gradient = np.zeros((len(numbers), *scores.gradient.shape[1:]))
    information = np.zeros((len(numbers), *scores.information.shape[1:]))
    np.add.at(gradient, index, scores.gradient)
    np.add.at(information, index, scores.information)
    return TimePieces(gradient, information, numbers // MOST_PIECES)


def correlation_time(series: np.ndarray, run: np.ndarray) -> float:
    """Integrated correlation time of a series (P,) over several runs, in its steps: `1 + 2 sum rho_l` up to the first
    non-positive sum of a pair of neighbouring lags (Geyer 1992); two correlation times for an exponential decay."""
    series = series - series.mean()
    size = max(series @ series, 1e-300)
    count = len(series)

    def rho(lag: int) -> float:
        earlier = series[: count - lag] * (run[lag:] == run[: count - lag])
        return series[lag:] @ earlier / size

    total = 0.0
    for lag in range(0, max(2, count // 2) - 1, 2):
        pair = rho(lag) + rho(lag + 1)
        if pair <= 0:
            break
        total += pair
    return max(1.0, 2 * total - 1)


def block_length(parts: TimePieces, information: np.ndarray) -> int:
    """Pieces per block: two correlation times of the parameters' scores, if `FEWEST_BLOCKS` blocks remain.

    Args:
        information: of all pieces (k, k).
    """
    influence = solve_spd(information, parts.gradient.T).T
    longest = max((correlation_time(column, parts.run) for column in influence.T), default=1.0)
    return int(max(1, min(np.ceil(longest), len(parts.run) // FEWEST_BLOCKS)))


def block_covariance(solution: Solution) -> tuple[np.ndarray, int] | None:
    """Covariance (k, k) of the free parameters by the scatter of this many blocks; None with too few pieces of time."""
    free = solution.free
    parts = time_pieces(solution, free)
    information = solution.free_information
    prior = solution.problem.prior(solution.values).curvature[np.ix_(free, free)]
    if len(parts.gradient) < FEWEST_BLOCKS or not len(free):
        return None
    length = block_length(parts, information)
    blocks = []
    for run in np.unique(parts.run):
        mine = np.flatnonzero(parts.run == run)
        blocks += np.split(mine, length * np.arange(1, len(mine) // length))  # the last one includes the remainder
    if len(blocks) < 2:
        return None
    inner = invert_spd(information)
    covariance = jackknife(parts, blocks, information)
    covariance = covariance + inner @ prior @ inner
    own = np.diag(covariance)
    drift = _half_difference(parts, information) ** 2
    # independent blocks explain four times the variance
    more = np.maximum(0.25 * drift, drift - 4 * own)
    return with_minimum_variance(covariance, own + more), len(blocks)


def jackknife(parts: TimePieces, blocks: Sequence[np.ndarray], information: np.ndarray) -> np.ndarray:
    """Covariance (k, k) of the estimates by leaving out each block of pieces."""
    moved = leave_out_moves(parts, blocks, information)
    return (len(blocks) - 1) / len(blocks) * moved.T @ moved


def with_minimum_variance(covariance: np.ndarray, minimum: np.ndarray) -> np.ndarray:
    """The covariance with these minimum variances (k,) and the same correlations."""
    grow = np.sqrt(np.maximum(minimum / np.maximum(np.diag(covariance), 1e-300), 1.0))
    return covariance * np.outer(grow, grow)


def leave_out_moves(parts: TimePieces, blocks: Sequence[np.ndarray], information: np.ndarray) -> np.ndarray:
    """Change of the estimates (B, k) without each block of pieces, to first order, minus their mean."""
    rests = [_positive(information - parts.information[mine].sum(0), information) for mine in blocks]
    moved = [solve_spd(rest, parts.gradient[mine].sum(0)) for rest, mine in zip(rests, blocks, strict=True)]
    return np.array(moved) - np.mean(moved, axis=0)


def resample(
    parts: TimePieces, information: np.ndarray, block: int, draws: int, rng: np.random.Generator
) -> tuple[np.ndarray, float]:
    """Moves of the estimates (draws, k) by blocks of `block` pieces drawn with replacement, and effective block count.

    Each block contributes the move `d_b = (S - S_b)^-1 g_b` of leaving it out. S^-1 g_b would be too small by the
    block's fraction of the information, because the fit has followed its noise. With B blocks drawn, the factor
    `sqrt((B - 1)/B)` gives the right size, exactly so for equal fractions. For blocks with different fractions h of the
    variance of an estimate, the effective count is 1/sum h^2, and the minimum over all estimates is used.
    """
    count = len(parts.run)
    number = int(np.ceil(count / block))
    blocks = (np.arange(count)[:, None] + np.arange(block)) % count  # any piece may be the first of a block
    moved = leave_out_moves(parts, list(blocks), information)
    moved *= np.sqrt((number - 1) / number * count / (number * block))
    found = moved[rng.integers(0, count, size=(draws, number))].sum(axis=1)
    apart = np.array([parts.information[i : i + block].sum(axis=0) for i in range(0, count, block)])
    inner = invert_spd(information)
    share = np.einsum("ij,bjk,ki->bi", inner, apart, inner)
    share = share / np.maximum(share.sum(axis=0), 1e-300)
    return found, np.min(1 / np.maximum(np.sum(share**2, axis=0), 1e-300), initial=number)


def _half_difference(parts: TimePieces, information: np.ndarray) -> np.ndarray:
    """Difference between the estimates (k,) of the first and the second half of the time, to first order."""
    middle = len(parts.run) // 2
    estimates = []
    for half in (slice(middle), slice(middle, None)):
        rest = _positive(parts.information[half].sum(0), information)
        estimates.append(solve_spd(rest, parts.gradient[half].sum(0)))
    return estimates[0] - estimates[1]


#: Fraction of the information that counts as remaining at least: with less, the move without a block is not linear.
LEAST_REMAINING = 0.1


def _positive(rest: np.ndarray, full: np.ndarray) -> np.ndarray:
    """The remaining information, at least `LEAST_REMAINING` of the whole in every direction."""
    scaled, size = scale_diagonal(full)
    root = np.linalg.cholesky(scaled + 1e-12 * np.eye(len(full)))
    inverse = np.linalg.inv(root)
    share, turn = np.linalg.eigh(inverse @ (rest * np.outer(size, size)) @ inverse.T)
    return (root @ (turn * np.maximum(share, LEAST_REMAINING)) @ turn.T @ root.T) / np.outer(size, size)
