"""Gradient descent with preconditioning: optax on the parameters, with the window starts eliminated inside.

Variable projection (Golub and Pereyra 1973): L(p) = min over starts z of the loss, with gradient g = P' r at that
minimum (the envelope theorem). Starts follow the parameters by one Gauss-Newton step each time, and g is corrected for
the remaining slope of the starts, so that a step needs one run of all windows. The loss is that of the default method:
windows that are separate or joined by weighted gaps, priors, poses at rest.

Parameters descend in coordinates x = L' p with S = L L', the information at the point where the coordinates were made.
One unit is one standard error (in units of the assumed noise) in every direction. This separates damping coefficients
with similar effects, whose plain gradients are nearly parallel. Coordinates are made again, and the optimizer restarts
from scratch, if the information has changed several times or a bound is met.

Descent stops when g' S^-1 g < 0.05^2: no combination of parameters is farther than 0.05 standard errors from the
minimum. Each component alone below 0.05 would stop half a standard error away if b_l and b_q correlate by -0.99.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from scipy.linalg import eigvalsh, solve_triangular

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import Progress, SceneError, nearest, silent
from fitting.estimate.gauss_newton import Point, Separate, fit_windows, minimise
from fitting.estimate.normal_equations import Evaluation, Normal, Step, bounded_step, cholesky_root
from fitting.estimate.problem import Problem
from fitting.estimate.sandwich import scores
from fitting.estimate.windows import Starts, Windows

#: Optimizers by name, without their learning rates. The gradients are exact, so short memories suffice: on quadratic
#: bowls whose information is wrong by up to a factor 3, adam needs 13 steps from 5 standard errors to 0.05, and 40 with
#: its usual memories (0.9, 0.999).
OPTIMIZERS: dict[str, optax.GradientTransformation] = {
    "lbfgs": optax.scale_by_lbfgs(memory_size=8, scale_init_precond=False),
    "adam": optax.scale_by_adam(b1=0.5, b2=0.9),
    "sgd": optax.identity(),
}
#: Default learning rates: of L-BFGS the first trial of its line search, of adam the first step as a fraction of the
#: distance predicted by the information, of plain gradient steps the fraction of that distance for each step.
RATES = {"lbfgs": 1.0, "adam": 0.3, "sgd": 0.5}
LOSSES, SETTINGS = ("angles", "spectrum"), ("optimizer", "learning_rate", "steps", "horizon", "loss")
#: Distance to the minimum, in standard errors, at which descent has converged.
ARRIVED = 0.05
#: The same on the way through the gap weights, as a fraction of the limit for Gauss-Newton steps. Their last step gets
#: much closer, and the evidence must agree with theirs to choose the same weight.
INTERMEDIATE = 0.25
#: Steps of adam, and of transformations of optax, between starts (Loshchilov and Hutter 2017: adam's cosine decay).
CYCLE = 20
#: Change of the information, in any direction, above which coordinates are made again.
CHANGED = 4.0
#: Trials of a line search, the factor between them, and the fraction of the predicted decrease that suffices.
TRIALS, SHORTER, ENOUGH = 12, 0.4, 1e-4
#: Step, in standard errors, below which a parameter stays on its bound.
STAYS = 1e-6


@dataclass(frozen=True)
class GradientDescent:
    """Descent by optax: used by `--method gradient` in every stage of a fit.

    Attributes:
        optimizer: `lbfgs` (with a backtracking line search), `adam` (cosine decay with restarts), `sgd`, or a gradient
            transformation of optax with its own learning rate, as a fraction of the predicted distance. It restarts
            every `CYCLE` steps, as `adam` does.
        learning_rate: see `RATES`; None uses those.
        steps: maximum steps of each stage: over separate windows, and at every gap weight.
        horizon: fractions of each window that are fitted in turn before the whole windows.
        loss: `angles`, or `spectrum`, which starts with amplitude spectra, whose basin is wide, and ends with angles.
        note: called with the loss of every step.
    """

    optimizer: str | optax.GradientTransformation = "lbfgs"
    learning_rate: float | None = None
    steps: int = 100
    horizon: Sequence[float] = (1.0,)
    loss: str = "angles"
    note: Callable[[str], None] = field(default=str, compare=False)

    def __post_init__(self) -> None:
        if isinstance(self.optimizer, str) and self.optimizer not in OPTIMIZERS:
            raise SceneError(f"optimizer: {self.optimizer!r} is unknown; {nearest(self.optimizer, OPTIMIZERS)}")
        if self.loss not in LOSSES:
            raise SceneError(f"loss: {self.loss!r} is unknown; {nearest(self.loss, LOSSES)}")
        rate = self.rate
        if not (np.isfinite(rate) and rate > 0):
            raise SceneError(f"learning_rate: {rate:g} is not positive; allowed: > 0, such as {self.usual_rate:g}")
        if self.learning_rate is not None and self.name == "optax":
            raise SceneError("learning_rate: is part of a transformation of optax. Use it with an optimizer's name")
        if self.steps < 1:
            raise SceneError(f"steps: {self.steps} is not positive; allowed: at least 1")
        if not all(0 < part <= 1 for part in self.horizon):
            raise SceneError(f"horizon: {tuple(self.horizon)} leaves no samples; allowed: parts above 0, at most 1")

    @property
    def usual_rate(self) -> float:
        """The default learning rate."""
        return RATES.get(self.name, 1.0)

    @property
    def rate(self) -> float:
        """The learning rate."""
        return self.usual_rate if self.learning_rate is None else self.learning_rate

    @property
    def name(self) -> str:
        """Of the optimizer."""
        return self.optimizer if isinstance(self.optimizer, str) else "optax"

    def first_stages(
        self, problem: Problem, values: np.ndarray, starts: Starts
    ) -> tuple[np.ndarray, Starts, list[dict[str, Any]]]:
        """Parameters, starts and history after the descent over spectra and early parts of windows, if requested."""
        parts = [part for part in self.horizon if part < 1.0]
        stages: list[Separate] = [Spectrum(problem)] if self.loss == "spectrum" else []
        stages += [Separate(replace(problem, windows=problem.windows.early(part))) for part in parts]
        values, history = np.asarray(values, float), []
        for objective in stages:
            # the starts at a horizon, also for spectra, are those fitted to its angles
            held = replace(objective.problem, frozen=np.ones(len(values), bool))
            begin = fit_windows(held, values, starts)
            found = minimise(objective, replace(begin, values=values, history=history), self.mover(objective))
            values, starts, history = found.values, found.starts, found.history
        return values, starts, history

    def mover(self, objective: Separate, count: int = 0) -> GradientSteps:
        """Its steps on an objective, after this number of evaluations."""
        return GradientSteps(self, objective, count)


def descent_of(settings: Mapping[str, Any], progress: Progress = silent) -> tuple[GradientDescent, Progress]:
    """The descent with these settings, with a progress function that receives the loss of every step.

    Raises:
        SceneError: an unknown setting, or a value out of range.
    """
    last = [0.0]

    def show(fraction: float, text: str) -> None:
        last[0] = fraction
        progress(fraction, text)

    for name in settings:
        if name not in SETTINGS:
            raise SceneError(f"method: 'gradient' has no setting {name!r}; {nearest(name, SETTINGS)}")
    return GradientDescent(**settings, note=lambda text: progress(last[0], text)), show


class GradientSteps:
    """Steps of an optimizer down an objective (`gauss_newton.Mover`).

    Attributes:
        taken: number of steps.
        damping: of the next step of the starts.
    """

    def __init__(self, descent: GradientDescent, objective: Separate, count: int = 0) -> None:
        self.descent, self.objective, self.count, self.taken = descent, objective, count, 0
        self.why = f"{objective.goal} in {descent.steps} steps of {descent.name}. Use more steps"
        self.damping, self.first, self.x = objective.damping, np.inf, None

    def report(self, point: Point, progress: Progress) -> None:
        record = self.objective.record(point.cost, point.values)
        stage = f"gap weight {record['gap_weight']:g}" if "gap_weight" in record else "separate windows"
        text = f"{stage}, {self.descent.name} step {self.taken}, loss per sample {record['loss']:.5g}"
        progress(min(self.taken / self.descent.steps, 0.99), text)
        self.descent.note(text)

    def is_minimum(self, moved: float, decrease: float) -> bool:
        close = self.objective.close
        part = INTERMEDIATE if close > ARRIVED**2 else 1.0
        return moved < max(INTERMEDIATE * close, ARRIVED**2) and decrease < part * self.objective.little()

    def move(self, point: Point, newton: Step | None, near: bool) -> Point | None:
        problem = self.objective.problem
        if self.taken == 0:
            self.first = point.cost
        if self.taken == self.descent.steps or newton is None:
            return None
        # parameters stay on a bound according to the quadratic model
        size = newton.dp * np.sqrt(np.diag(newton.information))
        low, high = problem.bounds(point.values)
        at_bound = (point.values <= low) & (size < STAYS) | (point.values >= high) & (size > -STAYS)
        free = ~problem.held_mask & ~at_bound
        if self.x is None or self.x.is_outdated(newton, free):
            self.x = Coordinates(self.descent, point.values, newton, free)
        found = self._next(point, newton)
        if found is None and self.x.taken > 1:  # its memory of earlier steps is misleading
            self.x = Coordinates(self.descent, point.values, newton, free)
            found = self._next(point, newton)
        if found is None:
            self.why = ""
            return None
        self.taken += 1
        # growth of the loss, relative to the larger of its first value and 1 per sample, that counts as divergence
        if found.cost < 10.0 * max(self.first, 0.5 * problem.samples):
            return found
        descent = self.descent
        size = f"grew from {self.first:.3g} to {found.cost:.3g}" if np.isfinite(found.cost) else "is not finite"
        advice = f"Use {descent.usual_rate:g}" if descent.rate > descent.usual_rate else "Use a smaller one"
        self.why = f"the loss {size} after {self.taken} steps of {descent.name} with learning rate {descent.rate:g}. "
        self.why += advice
        return None

    def _next(self, point: Point, newton: Step) -> Point | None:
        """The next point; None if a line search finds none."""
        objective, problem, nowhere = self.objective, self.objective.problem, 0 * point.values
        direction, (low, high) = self.x.step(point.values, newton.gradient), problem.bounds(point.values)
        span = np.where(direction > 0, high - point.values, low - point.values)
        ahead = (direction != 0) & (span != 0)
        direction = np.where(ahead, direction, 0.0) * np.min(span[ahead] / direction[ahead], initial=1.0)
        slope, searched = float(newton.gradient @ direction), self.descent.name == "lbfgs"
        if searched and not slope < 0:
            return None
        for trial in range(TRIALS if searched else 1):
            self.count += 1
            # starts follow the parameters; a shorter step also withholds more of their own move
            damping = self.damping * 10.0**trial
            step = objective.solve(point.system, point.values, damping, nowhere, nowhere)
            if step is None:
                continue
            part = SHORTER**trial
            values = np.clip(point.values + part * direction, low, high)
            dz = step.dz + step.eliminated @ (values - point.values)
            evaluation = problem.evaluate(values, problem.move_starts(point.evaluation.starts, point.values, dz))
            cost = objective.cost(evaluation, values)
            if not searched or cost <= point.cost + ENOUGH * part * slope:
                # minimum damping of the starts' steps
                self.damping = max(0.1 * damping, 1e-9)
                system = objective.system(evaluation, values) if np.isfinite(cost) else None
                return Point(values, evaluation, cost, system)
        return None


class Coordinates:
    """Coordinates x = L' p of the free parameters, L L' = S, and an optimizer in them.

    Attributes:
        taken: steps since the coordinates were made.
        distance: to the minimum along each, predicted by the information. Steps of adam, which have the same size for
            any gradient, start with fractions of it: the common direction of b_l and b_q may be hundreds of units from
            the minimum and the other one only a few.
    """

    def __init__(self, descent: GradientDescent, values: np.ndarray, newton: Step, free: np.ndarray) -> None:
        self.descent, self.free, self.taken = descent, free, 0
        square = newton.information[np.ix_(free, free)]
        size = np.sqrt(np.maximum(np.diag(square), 1e-300))
        self.root = size[:, None] * cholesky_root(square / np.outer(size, size))
        slope = np.abs(self._slope(newton.gradient))
        # minimum distance along a coordinate, as a fraction of that along all of them
        self.distance = np.maximum(slope, max(0.1 * np.linalg.norm(slope), 1e-300))
        # a transformation of optax works in units of the distance: steps of a given size are fractions of it
        self.unit = self.distance if descent.name == "optax" else 1.0
        transform = OPTIMIZERS.get(descent.name, descent.optimizer)
        self.state = transform.init(jnp.asarray(self.root.T @ values[free] / self.unit))

    def _slope(self, gradient: np.ndarray) -> np.ndarray:
        """A gradient with respect to the coordinates."""
        return solve_triangular(self.root, gradient[self.free], lower=True)

    def is_outdated(self, newton: Step, free: np.ndarray) -> bool:
        """Whether the information or the set of free parameters has changed, or a cycle has ended."""
        restarts = self.descent.name in ("adam", "optax") and self.taken == CYCLE
        if restarts or not np.array_equal(free, self.free):
            return True
        change = eigvalsh(newton.information[np.ix_(free, free)], self.root @ self.root.T)
        return bool(change[0] < 1 / CHANGED or change[-1] > CHANGED)

    def step(self, values: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """The optimizer's step of the parameters (k,); zero for parameters that are not free."""
        name, rate = self.descent.name, self.descent.rate
        slope, x = (jnp.asarray(a / self.unit) for a in (self._slope(gradient), self.root.T @ values[self.free]))
        if name == "optax":
            update, self.state = self.descent.optimizer.update(slope, self.state, x)
            rate = -self.unit
        else:
            update, self.state = _update(name, slope, self.state, x)
        if name == "adam":
            rate = self.distance * (0.5 * rate * (1 + np.cos(np.pi * self.taken / CYCLE)))
        self.taken += 1
        found = np.zeros(len(values))
        found[self.free] = solve_triangular(self.root.T, -rate * np.asarray(update))
        return found


@cached_jit(static=("name",))
def _update(name: str, gradient: jax.Array, state: Any, x: jax.Array) -> tuple[jax.Array, Any]:
    return OPTIMIZERS[name].update(gradient, state, x)


class Spectrum(Separate):
    """Half the squared distance of amplitude spectra; the starts are those that the angles determine.

    Per window and link, with x the angles minus their mean: `1/2 sum_f (|X_f| - |Y_f|)^2/(S s^2)`, X the simulated and
    Y the measured discrete Fourier transform; blind to the phase, so its basin is wide.
    """

    goal = "no convergence of the spectra"

    def cost(self, evaluation: Evaluation, values: np.ndarray) -> float:
        if not np.isfinite(evaluation.residual).all():
            return np.inf
        return spectrum_terms(evaluation, self.problem.windows)[0] + self.problem.prior(values).cost

    def system(self, evaluation: Evaluation, values: np.ndarray) -> Normal:
        self.evaluation = evaluation  # of the point whose equations are solved next
        return super().system(evaluation, values)

    def solve(
        self, system: Normal, values: np.ndarray, damping: float, low: np.ndarray, high: np.ndarray
    ) -> Step | None:
        """The angles' step with the gradient of the spectra; starts move too: no envelope theorem holds."""
        step = super().solve(system, values, damping, low, high)
        if step is None:
            return None
        slope = scores(self.evaluation, step)
        gradient = spectrum_terms(self.evaluation, self.problem.windows, slope)[1] + self.problem.prior(values).gradient
        return step._replace(gradient=gradient, dp=bounded_step(step.information, gradient, low, high))


def spectrum_terms(
    evaluation: Evaluation, windows: Windows, slope: np.ndarray | None = None
) -> tuple[float, np.ndarray | None]:
    """The loss of the spectra and its gradient (k,) from the residuals' slopes (K, S, n, k), if given."""
    known = windows.weight > 0
    count = np.maximum(known.sum(axis=1, keepdims=True), 1)
    deviation = np.where(known, 1 / np.where(known, windows.weight, 1), 0.0)

    def spectrum(angle: np.ndarray) -> np.ndarray:
        """Of angles (..., K, S, n) minus their means."""
        mean = np.sum(angle, axis=-2, keepdims=True, where=known) / count
        return np.fft.rfft(np.where(known, angle - mean, 0.0), axis=-2)

    simulated = spectrum(evaluation.theta)
    size = np.maximum(np.abs(simulated), 1e-9)
    rest = size - np.abs(spectrum(evaluation.theta - evaluation.residual * deviation))
    scale = (windows.weight.max(axis=1, keepdims=True) ** 2) / windows.theta.shape[1]
    cost = 0.5 * float(np.sum(scale * rest**2))
    if slope is None:
        return cost, None
    amplitude = np.real(np.conj(simulated) * spectrum(deviation * np.moveaxis(slope, -1, 0))) / size
    return cost, np.einsum("ksn,pksn->p", scale * rest, amplitude)
