"""Check of the step size against the errors of a fit: effect of halving it on an estimate, and continuation if needed.

A scheme of order q leaves an error e h^q in the simulated angles, which shifts the estimate. One Gauss-Newton step from
the optimum with all residuals (and gaps) of half the step gives this shift d to first order, so that the bias is

    b(h) ~ -d / (1 - 2^-q),       b(h/2) ~ b(h) / 2^q

If b is not small compared with the standard error, the fit continues with half the step. Joined windows of long traces,
with errors of 0.1 %, need it. Steps are halved inside the compiled program: nothing is compiled again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dropper_jax.base.progress import Progress, silent
from fitting.estimate.least_squares import continue_fit, fit_windows
from fitting.estimate.objective import objective_at
from fitting.estimate.solution import Solution
from fitting.estimate.uncertainty import uncertainty

#: Bias of the step that is accepted, in standard errors: it is nearly all of the error of a fit without noise, which
#: has to stay below 0.2. The prediction was up to 13 % too small on a rig of 63 rad/s (`benchmarks/fit_bias.py`).
LARGEST_BIAS = 0.15
#: Bias below which the prediction from the coarser step for half of it is accepted without a check.
SURE_BIAS = 0.1


def fit_again(ahead: Solution) -> Solution:
    """Continue from a solution whose windows, separate or joined, have finer steps."""
    if ahead.gap_weight:
        return continue_fit(ahead)
    return fit_windows(ahead.problem, ahead.values, ahead.starts)


def refine(
    solution: Solution,
    progress: Progress = silent,
    again: Callable[[Solution], Solution] = fit_again,
    sure: float = SURE_BIAS,
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
        worst = np.max(np.abs(solution.step_bias), initial=0.0)
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


def with_finer_step(solution: Solution) -> Solution | None:
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
    problem = ahead.problem
    values = ahead.values
    if not np.isfinite(ahead.evaluation.residual).all():
        return np.full(len(values), np.nan)
    step = objective_at(problem, ahead.gap_weight).undamped_step(ahead.evaluation, values)
    if step is None:
        return np.zeros(len(values))
    return step.dp
