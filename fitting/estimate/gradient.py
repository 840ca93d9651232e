"""Plain gradient descent that works: optax on the parameters, the window starts eliminated inside.

Variable projection (Golub and Pereyra 1973): L(p) = min over starts z of the loss; at that minimum the envelope theorem
gives dL/dp = P' r, the partial derivative alone. Descent on starts and parameters together is hopelessly stiff, and
descent on one long run meets a loss that is flat but for a needle. The horizon grows: first only the early part of each
window counts, then all of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import optax

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.progress import Progress, silent
from fitting.estimate.evaluation import Evaluation
from fitting.estimate.gauss_newton import closed_starts, fit_windows, move
from fitting.estimate.normal_equations import Normal, Prior, Step, eliminate
from fitting.estimate.problem import Problem, Solution
from fitting.estimate.windows import Starts, Windows

OPTIMIZERS, LOSSES = ("lbfgs", "adam"), ("angles", "spectrum")
#: Inner Gauss-Newton steps on the starts before each gradient; they follow the parameters from call to call.
INNER = 2
#: Gradient, in standard errors of its parameter, at which descent has arrived.
ARRIVED = 0.05
#: Restarts of adam in each stage.
ADAM_ROUNDS = 3
#: Share of chi-square by which amplitude spectra join the loss.
SPECTRUM_FLOOR = 1e-9


def spectrum_terms(evaluation: Evaluation, windows: Windows, slope: np.ndarray) -> tuple[float, np.ndarray]:
    """Half the squared distance of amplitude spectra and its gradient (k,), from the residuals' slopes (K, S, n, k).

    Per window and link, with x the angles less their mean: `1/2 sum_f (|X_f| - |Y_f|)^2/(S s^2)`, X the simulated and
    Y the measured discrete Fourier transform; blind to the phase, so its basin is wide.
    """
    known = windows.weight > 0
    count = np.maximum(known.sum(axis=1, keepdims=True), 1)

    def centre(angle: np.ndarray) -> np.ndarray:
        return np.where(known, angle - np.sum(np.where(known, angle, 0.0), axis=1, keepdims=True) / count, 0.0)

    simulated = np.fft.rfft(centre(evaluation.theta), axis=1)
    measured_angle = evaluation.theta - np.where(known, evaluation.residual / np.where(known, windows.weight, 1), 0.0)
    measured = np.abs(np.fft.rfft(centre(measured_angle), axis=1))
    size = np.maximum(np.abs(simulated), SPECTRUM_FLOOR)
    rest = size - measured
    scale = (windows.weight.max(axis=1, keepdims=True) ** 2) / windows.theta.shape[1]
    cost = 0.5 * float(np.sum(scale * rest**2))
    slope = np.where(known, 1 / np.where(known, windows.weight, 1), 0.0)[..., None] * slope
    slope = slope - slope.sum(axis=1, keepdims=True) / count[..., None]
    moved = np.fft.rfft(np.where(known[..., None], slope, 0.0), axis=1)
    amplitude = np.real(np.conj(simulated)[..., None] * moved) / size[..., None]
    return cost, np.einsum("ksn,ksnp->p", scale * rest, amplitude)


class Projected:
    """The loss at the optimum of the starts, and its gradient by the parameters; keeps the starts between calls.

    Attributes:
        kind: `angles` or `spectrum`.
        information, curvature: of the last call, (k, k) and its diagonal.
    """

    def __init__(self, problem: Problem, starts: Starts, kind: str = "angles") -> None:
        self.problem, self.starts, self.kind = problem, starts, kind
        self.evaluations = 0
        k = len(problem.parameters)
        self.zero, self.curvature, self.information = np.zeros(k), np.ones(k), np.eye(k)

    def _starts_eliminated(self, normal: Normal, damping: float) -> Step:
        return eliminate(normal, damping, Prior(0.0, self.zero, np.diag(self.zero)), self.zero, self.zero)

    def __call__(self, values: np.ndarray, inner: int = INNER) -> tuple[float, np.ndarray]:
        problem, best = self.problem, None
        for i in range(inner + 1):
            evaluation = problem.evaluate(values, self.starts)
            self.evaluations += 1
            cost = problem.data_cost(evaluation)
            if best is not None and not cost <= best[0]:
                break
            best = (cost, evaluation, closed_starts(evaluation))
            if not np.isfinite(cost) or i == inner:
                break
            step = self._starts_eliminated(problem.normal(evaluation), 1e-6)
            self.starts = move(problem.simulator, best[2], values, step.dz)
        cost, evaluation, self.starts = best
        normal = problem.normal(evaluation)
        reduced = self._starts_eliminated(normal, 0.0)
        self.information = reduced.information
        self.curvature = np.maximum(np.diag(reduced.information), 1e-300)
        gradient, prior = normal.gp, problem.prior(values)
        if self.kind == "spectrum":
            # the starts are where the angles want them, not the spectra: no envelope theorem, they move along
            m2, jacobian = problem.freedoms, evaluation.jacobian
            slope = jacobian[..., m2:] + np.einsum("ksnj,kjp->ksnp", jacobian[..., :m2], reduced.eliminated)
            cost, gradient = spectrum_terms(evaluation, problem.windows, slope)
        return cost + prior.cost, gradient + prior.gradient


def fit_gradient(
    problem: Problem,
    values: np.ndarray,
    starts: Starts,
    *,
    optimizer: str = "lbfgs",
    loss: str = "angles",
    steps: int = 60,
    learning_rate: float | None = None,
    horizon: Sequence[float] = (0.3, 1.0),
    progress: Progress = silent,
) -> Solution:
    """Fit by gradient descent with optax.

    Args:
        optimizer: `lbfgs` (with a backtracking line search) or `adam` (cosine decay).
        loss: `angles`, or `spectrum`, which starts with amplitude spectra and ends with the angles.
        steps: most steps over all horizons.
        learning_rate: of adam, in parts of the distance that the curvature predicts; default 0.2.
        horizon: parts of each window that count, one after another.

    Returns:
        A solution like `fit_windows`'s, with covariance from the same normal equations.
    """
    for key, value, allowed in (("optimizer", optimizer, OPTIMIZERS), ("loss", loss, LOSSES)):
        if value not in allowed:
            raise SceneError(f"{key}: {value!r} is unknown; {nearest(value, allowed)}")
    values, history, evaluations = np.asarray(values, float), [], 0
    stages = [(part, "angles") for part in horizon]
    stages = [(1.0, "spectrum"), *stages] if loss == "spectrum" else stages
    arrived = False
    for i, (part, kind) in enumerate(stages):
        # angles decide the start values; the spectrum needs starts from the angles too
        projected = Projected(replace(problem, windows=problem.windows.early(part)), starts, kind)
        share = steps // len(stages) if i < len(stages) - 1 else steps - len(history)
        descend = _lbfgs if optimizer == "lbfgs" else _adam
        values, arrived = descend(projected, values, max(share, 1), learning_rate or 0.2, history)
        starts, evaluations = projected.starts, evaluations + projected.evaluations
        progress(0.9 * (i + 1) / len(stages), f"horizon {part:g}, {kind}: {values}")
    found = fit_windows(replace(problem, frozen=np.ones(len(values), bool)), values, starts, iterations=8)
    return replace(
        found,
        problem=problem,
        iterations=evaluations,
        history=history,
        status="ok" if arrived else "not_converged",
        message="" if arrived else f"no convergence in {steps} gradient steps",
    )


def _at_rest(projected: Projected, values: np.ndarray, gradient: np.ndarray, cost: float) -> bool:
    """Whether the projected gradient is below `ARRIVED` standard errors in every parameter."""
    low, high = projected.problem.bounds(values)
    held = ((values <= low) & (gradient > 0)) | ((values >= high) & (gradient < 0))
    unit = max(2 * cost / max(projected.problem.windows.samples, 1), 1e-12)
    return bool(np.all(np.abs(np.where(held, 0.0, gradient)) < ARRIVED * np.sqrt(projected.curvature * unit)))


def _lbfgs(
    projected: Projected, values: np.ndarray, steps: int, rate: float, history: list[dict[str, Any]]
) -> tuple[np.ndarray, bool]:
    low, high = projected.problem.bounds(values)
    cost, gradient = projected(values, inner=6)
    size = 1 / np.sqrt(projected.curvature)
    transform = optax.scale_by_lbfgs(memory_size=8)
    state = transform.init(jnp.asarray(values / size))
    for _ in range(steps):
        if _at_rest(projected, values, gradient, cost):
            return values, True
        update, state = transform.update(jnp.asarray(gradient * size), state, jnp.asarray(values / size))
        direction = -np.asarray(update) * size
        if direction @ gradient >= 0:
            direction = -gradient * size**2
        fraction, kept = 1.0, projected.starts
        for _ in range(12):
            trial = np.clip(values + fraction * direction, low, high)
            projected.starts = kept
            trial_cost, trial_gradient = projected(trial)
            if trial_cost <= cost + 1e-4 * float(gradient @ (trial - values)):
                break
            fraction *= 0.4
        else:
            projected.starts = kept
            return values, _at_rest(projected, values, gradient, cost)
        values, cost, gradient = trial, trial_cost, trial_gradient
        history.append({"cost": cost, "values": values.tolist()})
    return values, _at_rest(projected, values, gradient, cost)


def _adam(
    projected: Projected, values: np.ndarray, steps: int, rate: float, history: list[dict[str, Any]]
) -> tuple[np.ndarray, bool]:
    """Adam in coordinates x = L' p, where S = L L': damping coefficients that stand in for each other are apart there.

    Rounds of cosine decay with restarts (Loshchilov and Hutter 2017); each starts with steps of `rate` of the distance
    that its curvature predicts, so that the last ones are as small as the standard errors.
    """
    low, high = projected.problem.bounds(values)
    _, gradient = projected(values, inner=6)
    share = max(1, steps // ADAM_ROUNDS)
    for _ in range(min(ADAM_ROUNDS, steps)):
        root = np.linalg.cholesky(projected.information + 1e-12 * np.diag(projected.curvature))
        whiten = lambda g, root=root: jnp.asarray(np.linalg.solve(root, g))  # noqa: E731
        distance = float(np.linalg.norm(whiten(gradient)))
        transform = optax.adam(optax.cosine_decay_schedule(rate * distance, share))
        x = jnp.asarray(root.T @ values)
        state = transform.init(x)
        for _ in range(share):
            update, state = transform.update(whiten(gradient), state, x)
            values = np.clip(np.linalg.solve(root.T, np.asarray(optax.apply_updates(x, update))), low, high)
            x = jnp.asarray(root.T @ values)
            cost, gradient = projected(values, inner=1)
            history.append({"cost": cost, "values": values.tolist()})
    return values, _at_rest(projected, values, gradient, cost)
