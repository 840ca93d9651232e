"""Is the step fine enough for errors this small? What halving it does to an estimate, and going on with finer steps.

A scheme of order q leaves an error e h^q in the simulated angles, which moves the estimate. One Gauss-Newton step from
the optimum with all residuals (and gaps) of half the step gives that move d to first order, so that the bias is

    b(h) ~ -d / (1 - 2^-q),       b(h/2) ~ b(h) / 2^q

Where b is no small part of a standard error the fit goes on with half the step; joined windows of long traces, whose
errors are a tenth of a per cent, need it. Steps are halved inside the compiled program: nothing is compiled again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError

from dropper_jax.base.progress import Progress
from fitting.estimate.gauss_newton import Solution, fit_windows
from fitting.estimate.normal_equations import eliminate, normal_blocks, prior_terms
from fitting.estimate.shooting import continue_shooting, joined_step
from fitting.estimate.simulator import Simulator
from fitting.estimate.uncertainty import uncertainty
from fitting.estimate.windows import Windows

#: Bias of the step that is accepted, in standard errors.
LARGEST_BIAS = 0.3
#: Most substeps of a step.
MOST_SUBSTEPS = 16


def refine(
    simulator: Simulator,
    windows: Windows,
    solution: Solution,
    *,
    huber: float | None = None,
    frozen: np.ndarray | None = None,
    progress: Progress | None = None,
) -> tuple[Solution, Windows]:
    """Go on from a converged solution with finer steps until their bias is below `LARGEST_BIAS` standard errors.

    Returns:
        The solution, its `step_bias` set, and the windows with the substeps it used.
    """
    while True:
        solution.step_bias, finer, ahead = step_bias(simulator, windows, solution, huber, frozen)
        worst = float(np.max(np.abs(solution.step_bias), initial=0.0))
        if not worst > LARGEST_BIAS or finer.substeps > MOST_SUBSTEPS:
            return solution, windows
        if progress:
            progress(0.0, f"the step's bias is {worst:.2g} standard errors: {finer.substeps} substeps")
        on = _go_on(simulator, finer, ahead, huber, frozen)
        if on.status != "ok":
            return solution, windows
        on.iterations += solution.iterations + 1
        solution, windows = on, finer


def finer_step(
    simulator: Simulator, windows: Windows, solution: Solution, huber: float | None, frozen: np.ndarray | None
) -> tuple[Windows, Solution] | None:
    """Windows of half the step, and the solution on them, where the step's bias is too large; else None."""
    bias, finer, ahead = step_bias(simulator, windows, solution, huber, frozen)
    if finer.substeps > MOST_SUBSTEPS or not np.max(np.abs(bias), initial=0.0) > LARGEST_BIAS:
        return None
    return finer, ahead


def step_bias(
    simulator: Simulator,
    windows: Windows,
    solution: Solution,
    huber: float | None = None,
    frozen: np.ndarray | None = None,
) -> tuple[np.ndarray, Windows, Solution]:
    """Bias (k,) in standard errors of a solution; the windows of half the step, and the solution evaluated on them."""
    finer = replace(windows, substeps=2 * windows.substeps)
    ahead = replace(solution, evaluation=simulator(solution.values, solution.starts, finer))
    moved = _moved(simulator, finer, ahead, huber, frozen)
    errors = uncertainty(solution, windows, simulator.parameters, simulator.freedoms, frozen).std_error
    left = 1 - 0.5**simulator.stepper.integrator.order
    return -moved / left / np.where(errors > 0, errors, np.inf), finer, ahead


def _moved(
    simulator: Simulator, finer: Windows, ahead: Solution, huber: float | None, frozen: np.ndarray | None
) -> np.ndarray:
    """The parameters' Gauss-Newton step (k,) on the finer residuals, inside the bounds."""
    if not np.isfinite(ahead.evaluation.residual).all():
        return np.zeros(len(ahead.values))
    frozen = np.zeros(len(ahead.values), bool) if frozen is None else frozen
    low = np.where(frozen, 0.0, np.array([p.low for p in simulator.parameters]) - ahead.values)
    high = np.where(frozen, 0.0, np.array([p.high for p in simulator.parameters]) - ahead.values)
    if ahead.gap_weight:
        step = joined_step(simulator, finer, ahead, huber, low, high)
        return np.zeros(len(ahead.values)) if step is None else step.dp
    normal = normal_blocks(ahead.evaluation, ahead.weights, simulator.freedoms)
    try:
        return eliminate(normal, 0.0, prior_terms(simulator.parameters, ahead.values), low, high).dp
    except LinAlgError:
        return np.zeros(len(ahead.values))


def _go_on(
    simulator: Simulator, finer: Windows, ahead: Solution, huber: float | None, frozen: np.ndarray | None
) -> Solution:
    if ahead.gap_weight:
        return continue_shooting(simulator, finer, ahead, huber, frozen)
    return fit_windows(simulator, finer, ahead.values, ahead.starts, huber=huber, frozen=frozen)
