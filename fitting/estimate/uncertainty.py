"""Uncertainty of a fit: covariance with correlated residuals, intervals at bounds, identifiability.

The Gauss-Newton covariance `s^2 S^-1` holds for white residuals of standard deviation s. If residuals are correlated,
or larger than the noise that the traces show, the scatter of blocks of scores is used instead.

A few blocks may scatter less by chance. The covariance is at least `s^2 (D/M + P)^-1`, that of noise with the memory of
the residuals: M samples count as one. D is the information of the measurements and P that of the priors.

Errors of estimates whose model is partly wrong: from the scatter of blocks of scores, not from the noise's size.

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
from dataclasses import dataclass
from itertools import takewhile
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri, stdtr, stdtrit

from fitting.estimate.loss import Loss
from fitting.estimate.normal_equations import Evaluation, Factor, Normal, Step, solve_spd
from fitting.estimate.residuals import Solution
from fitting.estimate.shooting import gaps, level_of

#: Minimum number of blocks, for any memory of the scores.
FEWEST = 4
#: Number of blocks below which intervals use Student's quantile and a warning is given.
FEW = 15


class Pieces(NamedTuple):
    """Gradients (P, k) and information (P, k, k) of pieces of time, in the order of their runs (P,)."""

    gradient: np.ndarray
    information: np.ndarray
    run: np.ndarray


class Scatter(NamedTuple):
    """Covariance (k, k) of the parameters by the scatter of this many blocks."""

    covariance: np.ndarray
    blocks: int


def scores(evaluation: Evaluation, step: Step | Solution) -> np.ndarray:
    """Derivative of every residual by the parameters along the optimum of the starts (K, S, n, k)."""
    m2 = step.eliminated.shape[1]
    jacobian = evaluation.jacobian
    return jacobian[..., m2:] + np.einsum("ksnj,kjp->ksnp", jacobian[..., :m2], step.eliminated)


def start_covariances(point: Solution) -> tuple[np.ndarray, float]:
    """Covariances (K, m2, m2) of the windows' starts at given parameters, and the log determinant of their inverse."""
    level = level_of(point.problem, point.gap_weight)
    system = level.system(point.evaluation, point.values)
    if isinstance(system, Normal):
        largest = np.einsum("kii->ki", system.A).max(initial=0.0)
        A = system.A + (1e-12 * largest + 1e-300) * np.eye(system.A.shape[1])
        return np.linalg.inv(A), float(np.linalg.slogdet(A)[1].sum())
    A = system.normal.A
    factor = Factor(A + 1e-13 * np.einsum("kii->ki", A).max() * np.eye(A.shape[1]), system.below)
    return factor.inverse_diagonal(), factor.log_determinant


def hat_diagonal(rows: np.ndarray, information: np.ndarray) -> np.ndarray:
    """Diagonal (...) of the hat matrix of rows (..., k) of this information (k, k), which may be singular."""
    size = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information * np.outer(size, size), hermitian=True) * np.outer(size, size)
    return np.einsum("...p,pq,...q->...", rows, inverse, rows, optimize=True)


def leverage(point: Solution) -> np.ndarray:
    """Degrees of freedom that the fit has used of each sample (K, S, n): the diagonal of its hat matrix."""
    m2 = point.problem.freedoms
    root = np.sqrt(point.weights)[..., None]
    free = np.flatnonzero(~point.problem.held_mask)
    own = root * point.evaluation.jacobian[..., :m2]
    taken = np.einsum("ksni,kij,ksnj->ksn", own, start_covariances(point)[0], own, optimize=True)
    if len(free):
        score = (root * scores(point.evaluation, point))[..., free]
        taken = taken + hat_diagonal(score, point.information[np.ix_(free, free)])
    return taken


def pieces(solution: Solution, free: np.ndarray) -> Pieces:
    """Parts of the gradient and the information of the free parameters (their numbers), of equal duration."""
    timing = solution.problem.timing()
    weights = solution.weights
    score = scores(solution.evaluation, solution)[..., free]
    weighted_score = np.einsum("ksnp,ksn->ksp", score, weights * solution.evaluation.residual)
    square = np.einsum("ksnp,ksn,ksnq->kspq", score, weights, score, optimize=True)
    # target number of pieces of time; a small number of windows is cut into them
    duration = timing.duration / max(60, timing.blocks) * (1 + 1e-9)

    def number(t: np.ndarray, run: np.ndarray) -> np.ndarray:
        """Run and piece of these times of runs, combined in one number."""
        since = np.floor((t - timing.begin[run]) / duration + 1e-6).astype(int)
        return run * 10**9 + np.maximum(since, 0)

    known = timing.known
    rows = [(number(timing.t, timing.run)[known], weighted_score[known], square[known])]
    if solution.gap_weight and solution.windows.follows.any():
        windows = solution.windows
        found = gaps(solution.problem.simulator, windows, solution.evaluation, solution.values)
        left = found.left
        right = found.left + 1
        along = solution.eliminated
        slope = (found.shared + found.before @ along[left] + found.after @ along[right])[..., free]
        slope = slope / solution.gap_weight
        gradient = np.einsum("gip,gi->gp", slope, found.value / solution.gap_weight)
        square = np.einsum("gip,giq->gpq", slope, slope)
        rows.append((number(windows.begin[right], windows.run[right]), gradient, square))
    numbers, gradients, squares = (np.concatenate(column) for column in zip(*rows, strict=True))
    names, index = np.unique(numbers, return_inverse=True)
    gradient, information = (np.zeros((len(names), *a.shape[1:])) for a in (gradients, squares))
    np.add.at(gradient, index, gradients)
    np.add.at(information, index, squares)
    return Pieces(gradient, information, names // 10**9)


def memory(series: np.ndarray, run: np.ndarray) -> float:
    """Integrated correlation time of a series (P,) over several runs, in its steps: `1 + 2 sum rho_l` up to the first
    non-positive sum of a pair of neighbouring lags (Geyer 1992); two correlation times for an exponential decay."""
    series = series - series.mean()
    size = max(float(series @ series), 1e-300)
    count = len(series)
    rho = lambda lag: float(series[lag:] @ (series[: count - lag] * (run[lag:] == run[: count - lag]))) / size  # noqa: E731
    pairs = (rho(lag) + rho(lag + 1) for lag in range(0, max(2, count // 2) - 1, 2))
    return max(1.0, 2 * sum(takewhile(lambda pair: pair > 0, pairs)) - 1)


def block_of(parts: Pieces, information: np.ndarray) -> int:
    """Pieces, of this total information (k, k), per block: two correlation times of the parameters' scores, if `FEWEST`
    blocks remain."""
    influence = solve_spd(information, parts.gradient.T).T
    longest = max((memory(column, parts.run) for column in influence.T), default=1.0)
    return int(max(1, min(np.ceil(longest), len(parts.run) // FEWEST)))


def scatter(solution: Solution, free: np.ndarray) -> Scatter | None:
    """Covariance of the free parameters by the scatter of blocks; None with too few pieces of time."""
    parts = pieces(solution, free)
    information = solution.information[np.ix_(free, free)]
    prior = solution.problem.prior(solution.values).curvature[np.ix_(free, free)]
    if len(parts.gradient) < FEWEST or not len(free):
        return None
    length = block_of(parts, information)
    # a run's last block includes the remainder
    part = [np.minimum(np.arange(n) // length, max(n // length - 1, 0)) for n in np.bincount(parts.run)]
    names, block = np.unique(np.stack([parts.run, np.concatenate(part)]), axis=1, return_inverse=True)
    blocks = names.shape[1]
    if blocks < 2:
        return None
    inner = solve_spd(information, np.eye(len(information)))
    covariance = jackknife(parts, [np.flatnonzero(block.ravel() == b) for b in range(blocks)], information)
    covariance = covariance + inner @ prior @ inner
    own = np.diag(covariance)
    drift = _half_difference(parts, information) ** 2
    # independent blocks explain four times the variance
    more = np.maximum(0.25 * drift, drift - 4 * own)
    return Scatter(raised_to(covariance, own + more), blocks)


def jackknife(parts: Pieces, blocks: Sequence[np.ndarray], information: np.ndarray) -> np.ndarray:
    """Covariance (k, k) of the estimates by leaving out each block of pieces."""
    moved = moves_without(parts, blocks, information)
    return (len(blocks) - 1) / len(blocks) * moved.T @ moved


def raised_to(covariance: np.ndarray, minimum: np.ndarray) -> np.ndarray:
    """The covariance with these minimum variances (k,) and the same correlations."""
    grow = np.sqrt(np.maximum(minimum / np.maximum(np.diag(covariance), 1e-300), 1.0))
    return covariance * np.outer(grow, grow)


def moves_without(parts: Pieces, blocks: Sequence[np.ndarray], information: np.ndarray) -> np.ndarray:
    """Change of the estimates (B, k) without each block of pieces, to first order, minus their mean."""
    rests = [_positive(information - parts.information[mine].sum(0), information) for mine in blocks]
    moved = [solve_spd(rest, parts.gradient[mine].sum(0)) for rest, mine in zip(rests, blocks, strict=True)]
    return np.array(moved) - np.mean(moved, axis=0)


def resample(
    parts: Pieces, information: np.ndarray, block: int, draws: int, rng: np.random.Generator
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
    moved = moves_without(parts, list(blocks), information)
    moved *= np.sqrt((number - 1) / number * count / (number * block))
    found = moved[rng.integers(0, count, size=(draws, number))].sum(axis=1)
    apart = np.array([parts.information[i : i + block].sum(axis=0) for i in range(0, count, block)])
    inner = solve_spd(information, np.eye(len(information)))
    share = np.einsum("ij,bjk,ki->bi", inner, apart, inner)
    share = share / np.maximum(share.sum(axis=0), 1e-300)
    return found, float(np.min(1 / np.maximum(np.sum(share**2, axis=0), 1e-300), initial=number))


def _half_difference(parts: Pieces, information: np.ndarray) -> np.ndarray:
    """Difference between the estimates (k,) of the first and the second half of the time, to first order."""
    middle = len(parts.run) // 2
    halves = (slice(middle), slice(middle, None))
    rests = [_positive(parts.information[half].sum(0), information) for half in halves]
    first, second = (solve_spd(rest, parts.gradient[half].sum(0)) for rest, half in zip(rests, halves, strict=True))
    return first - second


def _positive(rest: np.ndarray, full: np.ndarray) -> np.ndarray:
    """The remaining information, at least 10 % of the whole in every direction: beyond that a step is not linear."""
    size = 1 / np.sqrt(np.maximum(np.diag(full), 1e-300))
    root = np.linalg.cholesky(full * np.outer(size, size) + 1e-12 * np.eye(len(full)))
    inverse = np.linalg.inv(root)
    share, turn = np.linalg.eigh(inverse @ (rest * np.outer(size, size)) @ inverse.T)
    return (root @ (turn * np.maximum(share, 0.1)) @ turn.T @ root.T) / np.outer(size, size)


#: Probability of the reported intervals.
LEVEL = 0.90


@dataclass(frozen=True)
class Uncertainty:
    """Errors of the parameters.

    Attributes:
        covariance: (k, k).
        std_error: (k,).
        low, high: ends of the 90 % intervals (k,).
        at_bound: (k,) bool.
        noise: standard deviation of the residuals in units of the assumed noise.
        correlation_1: correlation of neighbouring residuals, one for each channel (c,).
        inflation: maximum factor on a standard error due to the correlation.
        undetermined: directions (name -> share) that the data do not determine.
        blocks: number of blocks of scores behind the errors; 0 if they come from the noise.
    """

    covariance: np.ndarray
    std_error: np.ndarray
    low: np.ndarray
    high: np.ndarray
    at_bound: np.ndarray
    noise: float
    correlation_1: float | np.ndarray
    inflation: float
    undetermined: tuple[dict[str, float], ...]
    blocks: int = 0

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix (k, k)."""
        size = np.where(self.std_error > 0, self.std_error, 1.0)
        return self.covariance / np.outer(size, size)


def degrees_of_freedom(solution: Solution) -> float:
    """Number of samples minus the degrees of freedom that the fit has used, by leverage."""
    return max(1.0, solution.problem.samples - float(leverage(solution).sum()))


def variance(solution: Solution) -> float:
    """Variance of the noise, in units of the assumed one, that scales the inverse information to the covariance."""
    problem = solution.problem
    residual = solution.evaluation.residual[solution.problem.sample_mask]
    return max(robust_variance(residual, problem.loss, degrees_of_freedom(solution)), problem.least_variance)


def robust_variance(residual: np.ndarray, loss: Loss, freedom: float) -> float:
    """Variance of residuals (N,) with this number of degrees of freedom, for estimates by a robust loss.

    With psi the slope of the loss and w its weights, means over the residuals,

        <psi^2> <w> / <psi'>^2

    and chi-square per degree of freedom for least squares (Huber 1973).
    """
    weights = loss.weights(residual)
    square = float(np.sum((weights * residual) ** 2)) / freedom
    return square * float(np.mean(weights)) / max(float(np.mean(loss.curvature(residual))), 1e-3) ** 2


def uncertainty(solution: Solution) -> Uncertainty:
    """Errors at a solution; the larger of those from the noise and from the blocks' scatter if noise is not all."""
    problem = solution.problem
    k = len(solution.values)
    free = np.flatnonzero(~problem.held_mask)
    noise2 = variance(solution)
    white = noise2 * _inverse(solution.information[np.ix_(free, free)])
    correlation, real = problem.correlation(solution)
    covariance = white
    inflation = 1.0
    blocks = 0
    if real or not problem.explains_residuals:
        found = scatter(solution, free)
        if found is not None:
            prior = problem.prior(solution.values).curvature[np.ix_(free, free)]
            data = solution.information[np.ix_(free, free)] - prior
            least = noise2 * np.diag(_inverse(data / problem.memory + prior))
            blocks = found.blocks
            covariance = raised_to(found.covariance, least)
            more = np.diag(covariance) / np.maximum(np.diag(white), 1e-300)
            inflation = float(np.sqrt(more.max(initial=1.0)))
    full = np.zeros((k, k))
    full[np.ix_(free, free)] = covariance
    full = full + problem.known.carried_covariance(np.where(problem.held_mask, 0.0, solution.values))
    se = np.sqrt(np.maximum(np.diag(full), 0.0))
    least, most = problem.bounds(solution.values)
    at_bound = ~problem.held_mask & ((solution.values <= least) | (solution.values >= most))
    return Uncertainty(
        full,
        se,
        *intervals(solution, full, free, blocks),
        at_bound,
        float(np.sqrt(noise2)),
        correlation,
        inflation,
        open_directions(solution, full, free),
        blocks,
    )


def _inverse(information: np.ndarray) -> np.ndarray:
    if len(information):
        return solve_spd(information, np.eye(len(information)))
    return information


def intervals(
    solution: Solution, covariance: np.ndarray, free: np.ndarray, blocks: float = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Ends (k,) of the intervals, cut at the bounds; by Student's law if the errors come from few blocks of time.

    On a bound the interval starts there and ends at the quantile of that law around the unbounded optimum,
    given that the parameter is inside its bounds.
    """
    values = solution.values
    se = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    reach = quantile(0.5 + LEVEL / 2, blocks) * se
    low = values - reach
    high = values + reach
    centre = values.copy()
    if len(free):
        centre[free] -= _inverse(solution.information[np.ix_(free, free)]) @ solution.gradient[free]
    for i in free:
        p = solution.problem.parameters[i]
        if values[i] <= p.low and se[i] > 0:
            below = chance_below((p.low - centre[i]) / se[i], blocks)
            low[i], high[i] = p.low, centre[i] + se[i] * quantile(below + LEVEL * (1 - below), blocks)
        elif values[i] >= p.high and se[i] > 0:
            below = chance_below((p.high - centre[i]) / se[i], blocks)
            low[i], high[i] = centre[i] + se[i] * quantile(below * (1 - LEVEL), blocks), p.high
        low[i], high[i] = max(low[i], p.low), min(high[i], p.high)
    return low, np.where(np.isfinite(high), high, values + reach)


def quantile(chance: float, blocks: float = 0) -> float:
    """Standard errors below which an estimate lies with this probability: Student's law for fewer blocks than `FEW`."""
    return float(stdtrit(blocks - 1, chance) if 0 < blocks < FEW else ndtri(chance))


def chance_below(distance: float, blocks: float = 0) -> float:
    """The inverse of `quantile`."""
    return float(stdtr(blocks - 1, distance) if 0 < blocks < FEW else ndtr(distance))


def open_directions(solution: Solution, covariance: np.ndarray, free: np.ndarray) -> tuple[dict[str, float], ...]:
    """Directions that are not identifiable: eigenvectors of the covariance in units of the parameters' sizes."""
    parameters = solution.problem.parameters
    if len(free) < 2 or not np.isfinite(covariance).all():
        return ()
    size = np.array([max(abs(solution.values[i]), parameters[i].scale * 0.1) for i in free])
    spread, direction = np.linalg.eigh(covariance[np.ix_(free, free)] / np.outer(size, size))
    found = []
    for variance, column in zip(spread[::-1], direction.T[::-1], strict=True):
        several = np.abs(column) > 0.2
        # relative standard error above which a direction counts as undetermined
        if np.sqrt(max(variance, 0.0)) > 1.0 and several.sum() > 1:
            column = column / np.abs(column).max()
            found.append({parameters[i].name: float(c) for i, c, s in zip(free, column, several, strict=True) if s})
    return tuple(found)
