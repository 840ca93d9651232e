"""Uncertainty of a fit: covariance with correlated residuals, intervals at bounds, bootstrap, identifiability.

The Gauss-Newton covariance `s^2 S^-1` holds for white residuals of standard deviation s. If residuals are correlated,
or larger than the noise that the traces show, the scatter of blocks of scores is used instead (`sandwich`).

A few blocks may scatter less by chance. The covariance is at least `s^2 (D/M + P)^-1`, that of noise with the memory of
the residuals: M samples count as one. D is the information of the measurements and P that of the priors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri, stdtr, stdtrit

from dropper_jax.base.errors import Progress, silent
from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.loss import Loss
from fitting.estimate.normal_equations import solve_spd
from fitting.estimate.problem import Solution
from fitting.estimate.sandwich import FEW, block_of, leverage, pieces, resample, scatter
from fitting.estimate.shooting import continue_shooting, level_of

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
    problem, residual = solution.problem, solution.evaluation.residual[solution.problem.sample_mask]
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
    problem, k = solution.problem, len(solution.values)
    free = np.flatnonzero(~problem.held_mask)
    noise2 = variance(solution)
    white = noise2 * _inverse(solution.information[np.ix_(free, free)])
    correlation, real = problem.correlation(solution)
    covariance, inflation, blocks = white, 1.0, 0
    if real or not problem.explains_residuals:
        found = scatter(solution, free)
        if found is not None:
            prior = problem.prior(solution.values).curvature[np.ix_(free, free)]
            data = solution.information[np.ix_(free, free)] - prior
            least = noise2 * np.diag(_inverse(data / problem.memory + prior))
            blocks, size = found.blocks, np.diag(found.covariance)
            grow = np.sqrt(np.maximum(least / np.maximum(size, 1e-300), 1.0))
            covariance = found.covariance * np.outer(grow, grow)
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
    return solve_spd(information, np.eye(len(information))) if len(information) else information


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
    low, high = values - reach, values + reach
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


class Bootstrap(NamedTuple):
    """Parameters (draws, k) of a bootstrap, and its effective number of blocks of time."""

    draws: np.ndarray
    blocks: float

    @property
    def warning(self) -> str:
        """One line if blocks are few, otherwise empty."""
        text = (
            f"the bootstrap draws from the equivalent of {self.blocks:.1f} blocks of time, fewer than {FEW}: the width "
            f"of its intervals is uncertain by {100 / np.sqrt(2 * max(self.blocks - 1, 1)):.0f} %. Use longer traces"
        )
        return text if self.blocks < FEW else ""


def bootstrap(solution: Solution, draws: int = 200, block: int | None = None, seed: int = 0) -> Bootstrap:
    """Parameters refitted, to first order, to blocks of time drawn with replacement (`sandwich.resample`).

    The information of a draw is that of all stretches, because a draw of few may leave a parameter undetermined (Kline
    and Santos 2012).

    Args:
        block: number of stretches drawn together: windows, or parts of few ones; default two correlation times.
    """
    free = np.flatnonzero(~solution.problem.held_mask)
    parts = pieces(solution, free)
    information = solution.information[np.ix_(free, free)]
    block = block or block_of(parts, information)
    moved, blocks = resample(parts, information, block, draws, np.random.default_rng(seed))
    found = np.tile(solution.values, (draws, 1))
    found[:, free] -= moved
    return Bootstrap(np.clip(found, *solution.problem.bounds(solution.values)), blocks)


# Check of the step size against the errors of a fit: effect of halving it on an estimate, and continuation if needed.
#
# A scheme of order q leaves an error e h^q in the simulated angles, which shifts the estimate. One Gauss-Newton step
# from the optimum with all residuals (and gaps) of half the step gives this shift d to first order, so that the bias
# is
#
#     b(h) ~ -d / (1 - 2^-q),       b(h/2) ~ b(h) / 2^q
#
# If b is not small compared with the standard error, the fit continues with half the step. Joined windows of long
# traces, with errors of 0.1 %, need it. Steps are halved inside the compiled program: nothing is compiled again.

#: Bias of the step that is accepted, in standard errors.
LARGEST_BIAS = 0.3
#: Bias below which the prediction from the coarser step for half of it is accepted without a check.
SURELY = 0.15


def fit_again(ahead: Solution) -> Solution:
    """Continue from a solution whose windows, separate or joined, have finer steps."""
    return continue_shooting(ahead) if ahead.gap_weight else fit_windows(ahead.problem, ahead.values, ahead.starts)


def refine(
    solution: Solution,
    progress: Progress = silent,
    again: Callable[[Solution], Solution] = fit_again,
    sure: float = SURELY,
) -> Solution:
    """Continue from a converged solution with finer steps until their bias is below `LARGEST_BIAS` standard errors.

    Args:
        again: continues from a solution with finer steps.
        sure: bias below which the prediction from the coarser step is accepted for half of it.

    Returns:
        The solution with its `step_bias`, and its problem with the steps used.
    """
    while True:
        solution.step_bias, ahead = step_bias(solution)
        worst = float(np.max(np.abs(solution.step_bias), initial=0.0))
        if not worst > LARGEST_BIAS or ahead.problem.finest:
            return solution
        progress(0.0, f"the step's bias is {worst:.2g} standard errors: halving the step")
        on = again(ahead)
        if on.status != "ok":
            return solution
        on.iterations += solution.iterations + 1
        on.step_bias = solution.step_bias * 0.5**solution.problem.order
        solution = on
        if np.max(np.abs(on.step_bias), initial=0.0) < sure:
            return on


def finer_step(solution: Solution) -> Solution | None:
    """The solution on windows of half the step if the step's bias is too large; otherwise None."""
    bias, ahead = step_bias(solution)
    if ahead.problem.finest or not np.max(np.abs(bias), initial=0.0) > LARGEST_BIAS:
        return None
    return ahead


def step_bias(solution: Solution) -> tuple[np.ndarray, Solution]:
    """Bias (k,) in standard errors of a solution, and the solution evaluated with half the step."""
    finer = solution.problem.finer()
    ahead = replace(solution, problem=finer, evaluation=finer.evaluate(solution.values, solution.starts))
    errors = uncertainty(solution).std_error
    left = 1 - 0.5**finer.order
    # the remaining step of the solution itself is not bias: a gradient descent stops 0.05 standard errors away
    return (_newton_step(solution) - _newton_step(ahead)) / left / np.where(errors > 0, errors, np.inf), ahead


def _newton_step(ahead: Solution) -> np.ndarray:
    """The parameters' Gauss-Newton step (k,) on a solution's residuals, inside the bounds."""
    problem, values = ahead.problem, ahead.values
    if not np.isfinite(ahead.evaluation.residual).all():
        return np.full(len(values), np.nan)
    step = level_of(problem, ahead.gap_weight).undamped_step(ahead.evaluation, values)
    return np.zeros(len(values)) if step is None else step.dp
