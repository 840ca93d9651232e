"""Uncertainty of a fit: covariance with correlated residuals, intervals at bounds, identifiability.

The Gauss-Newton covariance `s^2 S^-1` holds for white residuals of standard deviation s. If residuals are correlated,
or larger than the noise that the traces show, the scatter of blocks of scores is used instead
(see `blocks`).

A few blocks may scatter less by chance. The covariance is at least `s^2 (D/M + P)^-1`, that of noise with the memory of
the residuals: M samples count as one. D is the information of the measurements and P that of the priors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri, stdtr, stdtrit

from fitting.estimate.blocks import block_covariance, residual_scores, with_minimum_variance
from fitting.estimate.factors import Factor, invert_spd, scale_diagonal
from fitting.estimate.loss import Loss
from fitting.estimate.objective import objective_at
from fitting.estimate.solution import Solution

#: Number of blocks below which intervals use Student's quantile and a warning is given.
FEW_BLOCKS = 15


def start_covariances(point: Solution) -> tuple[np.ndarray, float]:
    """Covariances (K, m2, m2) of the windows' starts at given parameters, and the log determinant of their inverse."""
    system = objective_at(point.problem, point.gap_weight).system(point.evaluation, point.values)
    A = system.damped(0.0)
    if system.below is None:
        return np.linalg.inv(A), float(np.linalg.slogdet(A)[1].sum())
    factor = Factor(A, system.below)
    return factor.inverse_diagonal(), factor.log_determinant


def leverage(point: Solution) -> np.ndarray:
    """Degrees of freedom that the fit has used of each sample (K, S, n): the diagonal of its hat matrix."""
    m2 = point.problem.freedoms
    root = np.sqrt(point.weights)[..., None]
    free = point.free
    own = root * point.evaluation.jacobian[..., :m2]
    taken = np.einsum("ksni,kij,ksnj->ksn", own, start_covariances(point)[0], own, optimize=True)
    if len(free):
        score = (root * residual_scores(point.evaluation, point))[..., free]
        scaled, size = scale_diagonal(point.free_information)
        inverse = np.linalg.pinv(scaled, hermitian=True) * np.outer(size, size)
        taken = taken + np.einsum("...p,pq,...q->...", score, inverse, score, optimize=True)
    return taken


#: Probability of the reported intervals.
INTERVAL_LEVEL = 0.90


@dataclass(frozen=True)
class Uncertainty:
    """Errors of the parameters.

    Attributes:
        covariance: (k, k).
        std_error: (k,).
        low, high: ends of the 90 % intervals (k,).
        at_bound: (k,) bool.
        beyond_bound: distance (k,) [standard errors] of the optimum without bounds from a bound that holds a parameter;
            0 of the others.
        noise: standard deviation of the residuals in units of the assumed noise.
        correlation_1: correlation of neighbouring residuals (c,), of all angles, or of each channel.
        inflation: maximum factor on a standard error due to the correlation.
        undetermined: directions (name -> share) that the data do not determine.
        blocks: number of blocks of scores behind the errors; 0 if they come from the noise.
    """

    covariance: np.ndarray
    std_error: np.ndarray
    low: np.ndarray
    high: np.ndarray
    at_bound: np.ndarray
    beyond_bound: np.ndarray
    noise: float
    correlation_1: np.ndarray
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
    return max(1.0, solution.problem.samples - leverage(solution).sum())


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
    square = np.sum((weights * residual) ** 2) / freedom
    return square * np.mean(weights) / max(np.mean(loss.curvature(residual)), 1e-3) ** 2


def uncertainty(solution: Solution) -> Uncertainty:
    """Errors at a solution; the larger of those from the noise and from the blocks' scatter if noise is not all."""
    problem = solution.problem
    k = len(solution.values)
    free = solution.free
    noise2 = variance(solution)
    white = noise2 * invert_spd(solution.free_information)
    correlation, real = problem.correlation(solution)
    covariance = white
    inflation = 1.0
    blocks = 0
    if real or not problem.explains_residuals:
        found = block_covariance(solution)
        if found is not None:
            prior = problem.prior(solution.values).curvature[np.ix_(free, free)]
            data = solution.free_information - prior
            minimum = noise2 * np.diag(invert_spd(data / problem.memory + prior))
            covariance, blocks = found
            covariance = with_minimum_variance(covariance, minimum)
            more = np.diag(covariance) / np.maximum(np.diag(white), 1e-300)
            inflation = float(np.sqrt(more.max(initial=1.0)))
    full = np.zeros((k, k))
    full[np.ix_(free, free)] = covariance
    full = full + problem.known.carried_covariance(np.where(problem.held_mask, 0.0, solution.values))
    std_error = np.sqrt(np.maximum(np.diag(full), 0.0))
    lowest, highest = problem.bounds(solution.values)
    at_bound = ~problem.held_mask & ((solution.values <= lowest) | (solution.values >= highest))
    low, high = intervals(solution, std_error, blocks)
    beyond = unbounded_optimum(solution) - solution.values
    beyond = np.where(solution.values >= highest, beyond, -beyond) / np.maximum(std_error, 1e-300)
    return Uncertainty(
        covariance=full,
        std_error=std_error,
        low=low,
        high=high,
        at_bound=at_bound,
        beyond_bound=np.where(at_bound, beyond, 0.0),
        noise=float(np.sqrt(noise2)),
        correlation_1=correlation,
        inflation=inflation,
        undetermined=open_directions(solution, full),
        blocks=blocks,
    )


#: Share of the data in the information on a parameter with a prior, below which the difference of the two is rounding.
SMALLEST_DATA_SHARE = 1e-9


def unbounded_optimum(solution: Solution) -> np.ndarray:
    """The parameters (k,) at the minimum of the cost without bounds, to first order."""
    found = solution.values.copy()
    found[solution.free] -= invert_spd(solution.free_information) @ solution.gradient[solution.free]
    return found


def prior_conflicts(solution: Solution, u: Uncertainty) -> np.ndarray:
    """Distance (k,) between each parameter's own prior and what all else says of it; 0 without a prior or at a bound.

        d = (p - m)/sqrt(s^2 - c)

    in standard deviations of the difference, with the prior m +- s and the variance c of the estimate p by noise alone:
    the estimate without this prior is m + (p - m) s^2/(s^2 - c), and has the variance s^2 c/(s^2 - c). Errors that
    exceed those of the noise reduce d by the largest factor on any of them.
    """
    problem = solution.problem
    found = np.zeros(len(solution.values))
    variances = np.diag(invert_spd(solution.free_information))
    for i, c in zip(solution.free, variances, strict=True):
        prior = problem.parameters[i].prior
        if prior is None or u.at_bound[i]:
            continue
        mean, sigma = prior
        data_share = 1.0 - c / sigma**2
        if data_share > SMALLEST_DATA_SHARE:
            found[i] = (solution.values[i] - mean) / (sigma * np.sqrt(data_share))
    return found / max(1.0, u.inflation * u.noise)


def intervals(solution: Solution, se: np.ndarray, blocks: float) -> tuple[np.ndarray, np.ndarray]:
    """Ends (k,) of the intervals of these standard errors, cut at the bounds; by Student's law if they come from few
    blocks of time.

    On a bound the interval starts there and ends at the quantile of that law around the unbounded optimum,
    given that the parameter is inside its bounds.
    """
    values = solution.values
    reach = quantile(0.5 + INTERVAL_LEVEL / 2, blocks) * se
    low = values - reach
    high = values + reach
    centre = unbounded_optimum(solution)
    for i in solution.free:
        p = solution.problem.parameters[i]
        if values[i] <= p.low and se[i] > 0:
            below = chance_below((p.low - centre[i]) / se[i], blocks)
            high[i] = centre[i] + se[i] * quantile(below + INTERVAL_LEVEL * (1 - below), blocks)
        elif values[i] >= p.high and se[i] > 0:
            below = chance_below((p.high - centre[i]) / se[i], blocks)
            low[i] = centre[i] + se[i] * quantile(below * (1 - INTERVAL_LEVEL), blocks)
        low[i] = max(low[i], p.low)
        high[i] = min(high[i], p.high)
    # an optimum farther beyond its bound than the law has digits leaves no quantile
    return np.where(np.isfinite(low), low, values - reach), np.where(np.isfinite(high), high, values + reach)


def quantile(chance: float, blocks: float = 0) -> float:
    """Standard errors below which an estimate lies with this probability.

    Student's law holds for fewer blocks than `FEW_BLOCKS`.
    """
    if 0 < blocks < FEW_BLOCKS:
        return stdtrit(blocks - 1, chance)
    return ndtri(chance)


def chance_below(distance: float, blocks: float) -> float:
    """The inverse of `quantile`."""
    if 0 < blocks < FEW_BLOCKS:
        return stdtr(blocks - 1, distance)
    return ndtr(distance)


#: Relative standard error above which a direction counts as undetermined, and the share in it from which a parameter is
#: reported.
UNDETERMINED_ERROR = 1.0
NOTABLE_SHARE = 0.2


def open_directions(solution: Solution, covariance: np.ndarray) -> tuple[dict[str, float], ...]:
    """Directions that are not identifiable: eigenvectors of the covariance in units of the parameters' sizes."""
    parameters = solution.problem.parameters
    free = solution.free
    if len(free) < 2 or not np.isfinite(covariance).all():
        return ()
    size = np.array([max(abs(solution.values[i]), parameters[i].scale * 0.1) for i in free])
    spread, direction = np.linalg.eigh(covariance[np.ix_(free, free)] / np.outer(size, size))
    found = []
    for variance, column in zip(spread[::-1], direction.T[::-1], strict=True):
        several = np.flatnonzero(np.abs(column) > NOTABLE_SHARE)
        if variance > UNDETERMINED_ERROR**2 and len(several) > 1:
            column = column / np.abs(column).max()
            found.append({parameters[free[j]].name: column[j] for j in several})
    return tuple(found)
