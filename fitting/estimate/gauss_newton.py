"""Joint Gauss-Newton over window starts z_k and shared parameters p, the starts eliminated by a Schur complement.

    minimise  1/2 sum_k |W_k r_k(z_k, p)|^2 + prior

by damped steps of the equations in `normal_equations`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dropper_jax.base.progress import Progress
from fitting.estimate.normal_equations import data_cost, eliminate, huber_weights, normal_blocks, prior_terms
from fitting.estimate.simulator import Evaluation, Simulator
from fitting.estimate.windows import Starts, Windows
from fitting.traces.planar import chart

#: Converged when the next step would move the parameters by less than this part of their standard errors (squared).
STEP_TOLERANCE = 1e-4
#: and would lower chi-square by less than this.
DECREASE_TOLERANCE = 1e-2
#: The same for the step that is left where it does not lower the cost: dry friction's switches make the cost rough
#: (measured double pendulum: jumps of 1e-8 to 1e-4 of the cost, steps of 0.015 to 0.083 standard errors left; three
#: links with dry joints: 0.12). As far off as the time step may move the estimate, 0.3 standard errors.
ROUGH_TOLERANCE = 0.3**2
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


def move(simulator: Simulator, starts: Starts, values: np.ndarray, dz: np.ndarray) -> Starts:
    """Starts after a step in the chart, each window's kept within `LARGEST_MOVE`; not yet closed."""
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


def nearly_there(moved: float, decrease: float, samples: int) -> bool:
    """Whether a step that does not lower the cost says that the cost is rough, not that the step was too long.

    Args:
        moved: how far the step would go, in standard errors, squared.
        decrease: of chi-square that it promises. Window starts that are far off promise more than the deviation of
            chi-square itself, about the root of the samples, whatever the parameters do: they may be held.
    """
    return moved < ROUGH_TOLERANCE and decrease < np.sqrt(samples)


def fit_windows(
    simulator: Simulator,
    windows: Windows,
    values: np.ndarray,
    starts: Starts,
    *,
    huber: float | None = None,
    iterations: int = 40,
    frozen: np.ndarray | None = None,
    progress: Progress | None = None,
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
        accepted, near = False, nearly_there(moved, 2 * newton.predicted / unit, windows.samples)
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
            if near:  # a smooth cost would have fallen
                break
            damping = max(10 * damping, 1e-3)
        if not accepted:
            if near or damping >= LARGEST_DAMPING:
                status = "ok" if near else status
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
