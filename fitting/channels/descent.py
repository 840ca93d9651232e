"""Levenberg and Marquardt's method for whole runs: few parameters, many samples, bounds, priors and a robust loss."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import LinAlgError

from dropper_jax.base.progress import Progress, silent
from fitting.channels.noise import Noise, Rows, rows_of, scale_of
from fitting.channels.problem import Evaluation, Problem
from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.normal_equations import Prior, bounded_step, prior_of
from fitting.parameters.parameter import Parameter

#: Converged when the next step would move the parameters by less than this part of their standard errors.
STEP_TOLERANCE = 0.01
#: A step that does not lower the cost is no failure when it would move them by less than this.
ROUGH = 0.1
#: Largest factor by which one step may change a number that keeps its sign.
FACTOR = 3.0
LARGEST_DAMPING = 1e8


@dataclass
class Point:
    """Where a fit stands.

    Attributes:
        rows: residuals and derivatives in units of the noise; weights (N,) of the robust loss.
        information, gradient: of the cost by the parameters, priors included.
        prior: cost, gradient and curvature of the priors alone.
        status: `ok`, `not_converged` or `failed`; message why.
    """

    problem: Problem
    values: np.ndarray
    evaluation: Evaluation
    noise: Noise
    scales: tuple[tuple[np.ndarray, ...], ...]
    rows: Rows
    weights: np.ndarray
    cost: float
    information: np.ndarray
    gradient: np.ndarray
    prior: Prior
    loss: Loss = LEAST_SQUARES
    status: str = "not_converged"
    message: str = ""
    iterations: int = 0
    history: list[dict[str, object]] = field(default_factory=list)


def scales_of(problem: Problem, e: Evaluation) -> tuple[tuple[np.ndarray, ...], ...]:
    """By what the channels' sizes of noise count; held while the parameters move, or large values would be shunned."""
    return tuple(
        tuple(scale_of(s, shown) for s, shown in zip(problem.data.sensors, run, strict=True)) for run in e.shown
    )


def stand(
    problem: Problem,
    values: np.ndarray,
    e: Evaluation,
    noise: Noise,
    scales: tuple[tuple[np.ndarray, ...], ...],
    loss: Loss = LEAST_SQUARES,
) -> Point:
    """The normal equations at an evaluation that did not fail."""
    rows = rows_of(problem.data, e, noise, scales)
    weights = loss.weights(rows.residual)
    prior = prior_of(problem.parameters, values, problem.known.common)
    root = np.sqrt(weights)[:, None] * rows.jacobian
    return Point(
        problem=problem,
        values=values,
        evaluation=e,
        noise=noise,
        scales=scales,
        rows=rows,
        weights=weights,
        cost=loss.cost(rows.residual) + prior.cost,
        information=root.T @ root + prior.curvature,
        gradient=rows.jacobian.T @ (weights * rows.residual) + prior.gradient,
        prior=prior,
        loss=loss,
    )


def room(problem: Problem, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """By how much one step may change the parameters (p,), both ways."""
    low = np.array([p.low for p in problem.parameters]) - values
    high = np.array([p.high for p in problem.parameters]) - values
    for i, p in enumerate(problem.parameters):
        if yields(p) and values[i] > 0:
            ends = max(p.low, values[i] / FACTOR), min(p.high, values[i] * FACTOR)
            low[i], high[i] = (values[i] * (1 - values[i] / end) for end in ends)
        elif p.low >= 0 and values[i] > 0:
            low[i] = max(low[i], (1 / FACTOR - 1) * values[i]) if p.low > 0 else low[i]
            high[i] = min(high[i], (FACTOR - 1) * max(values[i], 0.1 * p.scale))
    return low, high


def yields(p: Parameter) -> bool:
    """Whether a motion follows the inverse of a parameter: an axial stiffness, by the stretch that it leaves."""
    return p.name.split("@")[0].rstrip(".0123456789").endswith(".EA") and p.low >= 0


def after(problem: Problem, values: np.ndarray, step: np.ndarray) -> np.ndarray:
    """The parameters after a step: `p + dp`, of stiffnesses the same of their inverse, `p/(1 - dp/p)`.

    A stiffness that hardly shows is far off to first order: Newton's step from 1e8 N would end below zero, that of the
    compliance ends where the stretch asks.
    """
    found = values + step
    for i, p in enumerate(problem.parameters):
        if yields(p) and values[i] > 0:
            found[i] = values[i] / (1 - step[i] / values[i])
    return found


def descend(point: Point, iterations: int, progress: Progress = silent) -> Point:
    """Go down from a point until the next step is a small part of the standard errors."""
    problem, damping, count = point.problem, 1e-3, 0
    while True:
        low, high = room(problem, point.values)
        newton = _step(point, 0.0, low, high)
        moved = np.inf
        if newton is not None:
            moved = float(np.sqrt(max(newton @ point.information @ newton, 0.0)))
            progress(min(count / iterations, 0.99), f"iteration {count}, next step {moved:.2g} standard errors")
            if moved < STEP_TOLERANCE:
                point.status, point.message = "ok", ""
                break
        if count >= iterations:
            point.message = f"no convergence in {iterations} iterations"
            break
        accepted, why = None, ""
        while damping < LARGEST_DAMPING and count < iterations:
            step = _step(point, damping, low, high)
            if step is None:
                damping *= 10
                continue
            values = after(problem, point.values, step)
            e = problem.evaluate(values, point.evaluation.near)
            count += 1
            why = e.failed or why
            if not e.failed:
                trial = stand(problem, values, e, point.noise, point.scales, point.loss)
                if trial.cost < point.cost:
                    accepted = trial
                    expected = -float(point.gradient @ step + 0.5 * step @ point.information @ step)
                    gain = (point.cost - trial.cost) / max(expected, 1e-300)
                    damping = max(damping * (0.1 if gain > 0.5 else 1.0 if gain > 0.1 else 3.0), 1e-9)
                    break
                if moved < ROUGH:
                    break
            damping = max(10 * damping, 1e-3)
        if accepted is None:
            near = moved < ROUGH
            point.status = "ok" if near else "not_converged"
            point.message = "" if near else (why or "no step lowers the cost")
            break
        accepted.iterations, accepted.history = point.iterations, point.history
        point = accepted
        point.history.append({"cost": point.cost, "values": point.values.tolist()})
    point.iterations += count
    return point


def _step(point: Point, damping: float, low: np.ndarray, high: np.ndarray) -> np.ndarray | None:
    try:
        matrix = point.information + damping * np.diag(np.diag(point.information))
        return bounded_step(matrix, point.gradient, low, high)
    except (LinAlgError, ValueError):
        return None
