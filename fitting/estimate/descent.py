"""Gradient descent: any optax optimizer on the loss of a fit, with the window starts eliminated inside.

Variable projection (Golub and Pereyra 1973): L(p) = min over starts z of the loss, with gradient g = P' r at that
minimum (the envelope theorem). Starts follow the parameters by one Gauss-Newton step each time, and g is corrected for
the remaining slope of the starts, so that a step needs one run of all windows. The loss is that of the default method:
windows that are separate or joined by weighted gaps, priors, poses at rest.

The optimizer works in coordinates x = L' p, by the preconditioner:

    information    S = L L', the information where the coordinates were made: one unit is one standard error (in units
                   of the assumed noise) in every direction. This separates damping coefficients with similar effects,
                   whose plain gradients are nearly parallel.
    size           L diagonal: every parameter in units of its own size. Plain gradients.

Coordinates are made again, and the optimizer restarts from scratch, if the information has changed several times, a
bound is met, or a cycle of steps has ended.

Descent stops when g' S^-1 g < 0.05^2: no combination of parameters is farther than 0.05 standard errors from the
minimum. Each component alone below 0.05 would stop half a standard error away if b_l and b_q correlate by -0.99.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from scipy.linalg import eigvalsh, solve_triangular

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.progress import Progress
from fitting.estimate.factors import cholesky_root
from fitting.estimate.least_squares import LEAST_DAMPING, Point
from fitting.estimate.normal_equations import Normal, Step
from fitting.estimate.objective import Objective

#: Steps between restarts of an optimizer without a line search (Loshchilov and Hutter 2017: adam's cosine decay).
CYCLE_STEPS = 20
#: Optimizers by name, as functions of the learning rate. The gradients are exact, so short memories suffice: on
#: quadratic bowls whose information is wrong by up to a factor 3, adam needs 13 steps from 5 standard errors to 0.05,
#: and 40 with its usual memories (0.9, 0.999).
OPTIMIZERS: dict[str, Callable[[float], optax.GradientTransformation]] = {
    "lbfgs": lambda rate: optax.chain(
        optax.scale_by_lbfgs(memory_size=8, scale_init_precond=False), optax.scale(-rate)
    ),
    "adam": lambda rate: optax.adam(optax.cosine_decay_schedule(rate, CYCLE_STEPS), b1=0.5, b2=0.9),
    "sgd": optax.sgd,
}
#: Default learning rates: of L-BFGS the first trial of its line search, of the others the first step as a fraction of
#: the distance to the minimum that the information predicts along each coordinate.
LEARNING_RATES = {"lbfgs": 1.0, "adam": 0.3, "sgd": 0.5}
PRECONDITIONERS = ("information", "size")
#: Distance to the minimum, in standard errors, at which descent has converged.
CONVERGED_DISTANCE = 0.05
#: The same on the way through the gap weights, as a fraction of the limit for Gauss-Newton steps. Their last step gets
#: much closer, and the evidence must agree with theirs to choose the same weight.
INTERMEDIATE_SHARE = 0.25
#: Change of the information, in any direction, above which coordinates are made again.
INFORMATION_CHANGE = 4.0
#: Trials of a line search, the factor between them, and the fraction of the predicted decrease that suffices.
SEARCH_TRIALS = 12
SEARCH_FACTOR = 0.4
SUFFICIENT_DECREASE = 1e-4
#: Step, in standard errors, below which a parameter stays on its bound.
BOUND_STEP = 1e-6
#: Growth of the loss, relative to the larger of its first value and 1 per sample, that counts as divergence.
DIVERGED_GROWTH = 10.0


@dataclass(frozen=True)
class GradientDescent:
    """Descent by optax: used by `--method gradient` in every stage of a fit.

    Attributes:
        optimizer: `lbfgs` (with a backtracking line search), `adam` (cosine decay with restarts), `sgd`, or a gradient
            transformation of optax with its own learning rate, as a fraction of the predicted distance.
        learning_rate: see `LEARNING_RATES`; None uses those.
        steps: maximum steps of each stage: over separate windows, and at every gap weight.
        preconditioner: `information` or `size`, the coordinates of the parameters.
    """

    optimizer: str | optax.GradientTransformation = "lbfgs"
    learning_rate: float | None = None
    steps: int = 100
    preconditioner: str = "information"

    def __post_init__(self) -> None:
        if isinstance(self.optimizer, str) and self.optimizer not in OPTIMIZERS:
            raise SceneError(f"optimizer: {self.optimizer!r} is unknown; {nearest(self.optimizer, OPTIMIZERS)}")
        if self.preconditioner not in PRECONDITIONERS:
            allowed = nearest(self.preconditioner, PRECONDITIONERS)
            raise SceneError(f"preconditioner: {self.preconditioner!r} is unknown; {allowed}")
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise SceneError(f"learning_rate: {self.rate:g} is not positive; allowed: > 0, such as {self.usual_rate:g}")
        if self.learning_rate is not None and self.name == "optax":
            raise SceneError("learning_rate: is part of a transformation of optax. Use it with an optimizer's name")
        if self.steps < 1:
            raise SceneError(f"steps: {self.steps} is not positive; allowed: at least 1")

    @property
    def name(self) -> str:
        """Of the optimizer."""
        if isinstance(self.optimizer, str):
            return self.optimizer
        return "optax"

    @property
    def usual_rate(self) -> float:
        """The default learning rate."""
        return LEARNING_RATES.get(self.name, 1.0)

    @property
    def rate(self) -> float:
        """The learning rate."""
        if self.learning_rate is None:
            return self.usual_rate
        return self.learning_rate

    @property
    def searches(self) -> bool:
        """Whether steps are shortened until they lower the loss."""
        return self.name == "lbfgs"

    @property
    def transformation(self) -> optax.GradientTransformation:
        """The optimizer in optax, whose updates are compiled."""
        if isinstance(self.optimizer, str):
            return _compiled(self.optimizer, self.rate)
        return self.optimizer

    def mover(self, objective: Objective, count: int) -> GradientSteps:
        """Its steps on an objective, after this number of evaluations."""
        return GradientSteps(self, objective, count)


@lru_cache
def _compiled(name: str, rate: float) -> optax.GradientTransformation:
    """The optimizer of a name; one per learning rate, so that its program is compiled once."""
    transformation = OPTIMIZERS[name](rate)
    return optax.GradientTransformation(transformation.init, jax.jit(transformation.update))


#: Minimum distance along a coordinate, as a fraction of that along all of them.
LEAST_DISTANCE = 0.1


class Coordinates:
    """Coordinates x = L' p of the free parameters, and an optimizer in them.

    Attributes:
        taken: steps since the coordinates were made.
        unit: of the optimizer along each coordinate: the distance to the minimum that the information predicts, so that
            steps of a given size are fractions of it. The common direction of b_l and b_q may be hundreds of standard
            errors from the minimum and the other one only a few.
    """

    def __init__(self, descent: GradientDescent, objective: Objective, point: Point, newton: Step, free: np.ndarray):
        self.descent = descent
        self.free = free
        self.taken = 0
        self.unit = 1.0
        if descent.preconditioner == "size":
            scale = np.array([p.scale for p in objective.problem.parameters])[free]
            self.root = np.diag(1 / scale)
        else:
            square = newton.information[np.ix_(free, free)]
            size = np.sqrt(np.maximum(np.diag(square), 1e-300))
            self.root = size[:, None] * cholesky_root(square / np.outer(size, size))
            if not descent.searches:
                slope = np.abs(self.slope(newton.gradient))
                self.unit = np.maximum(slope, max(LEAST_DISTANCE * np.linalg.norm(slope), 1e-300))
        self.state = descent.transformation.init(self.optimizer_position(point.values))

    def slope(self, gradient: np.ndarray) -> np.ndarray:
        """A gradient by the parameters (k,) as one by the coordinates."""
        return solve_triangular(self.root, gradient[self.free], lower=True)

    def optimizer_position(self, values: np.ndarray) -> Array:
        """The parameters (k,) as the optimizer sees them."""
        return jnp.asarray(self.root.T @ values[self.free] / self.unit)

    def is_outdated(self, newton: Step, free: np.ndarray) -> bool:
        """Whether the information or the set of free parameters has changed, or a cycle has ended."""
        if not np.array_equal(free, self.free) or (self.taken == CYCLE_STEPS and not self.descent.searches):
            return True
        if self.descent.preconditioner == "size":
            return False
        change = eigvalsh(newton.information[np.ix_(free, free)], self.root @ self.root.T)
        return bool(change[0] < 1 / INFORMATION_CHANGE or change[-1] > INFORMATION_CHANGE)

    def step(self, values: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """The optimizer's step of the parameters (k,); zero for parameters that are not free."""
        slope = jnp.asarray(self.slope(gradient) / self.unit)
        x = self.optimizer_position(values)
        update, self.state = self.descent.transformation.update(slope, self.state, x)
        self.taken += 1
        found = np.zeros(len(values))
        found[self.free] = solve_triangular(self.root.T, self.unit * np.asarray(update))
        return found


class GradientSteps:
    """Steps of an optimizer down an objective (`least_squares.Mover`).

    Attributes:
        taken: number of steps.
        damping: of the next step of the starts.
    """

    def __init__(self, descent: GradientDescent, objective: Objective, count: int) -> None:
        self.descent = descent
        self.objective = objective
        self.count = count
        self.taken = 0
        self.why = f"{objective.goal} in {descent.steps} steps of {descent.name}. Use more steps"
        self.damping = objective.damping
        self.first = np.inf
        self.x: Coordinates | None = None

    def report(self, point: Point, progress: Progress) -> None:
        record = self.objective.record(point.cost, point.values)
        stage = "separate windows"
        if record.gap_weight is not None:
            stage = f"gap weight {record.gap_weight:g}"
        text = f"{stage}, {self.descent.name} step {self.taken}, loss per sample {record.loss:.5g}"
        progress(min(self.taken / self.descent.steps, 0.99), text)

    def is_minimum(self, moved: float, decrease: float) -> bool:
        close = CONVERGED_DISTANCE**2
        little = self.objective.little()
        if self.objective.close > close:
            close = max(INTERMEDIATE_SHARE * self.objective.close, close)
            little *= INTERMEDIATE_SHARE
        return moved < close and decrease < little

    def move(self, point: Point, system: Normal, newton: Step | None, near: bool) -> Point | None:
        if self.taken == 0:
            self.first = point.cost
        if self.taken == self.descent.steps or newton is None:
            return None
        free = self._free(point, newton)
        x = self.x
        if x is None or x.is_outdated(newton, free):
            x = Coordinates(self.descent, self.objective, point, newton, free)
        found = self._next(x, point, system, newton)
        if found is None and x.taken > 1:  # its memory of earlier steps is misleading
            x = Coordinates(self.descent, self.objective, point, newton, free)
            found = self._next(x, point, system, newton)
        self.x = x
        if found is None:
            self.why = ""
            return None
        self.taken += 1
        if found.cost < DIVERGED_GROWTH * max(self.first, 0.5 * self.objective.problem.samples):
            return found
        self.why = self._explain_divergence(found.cost)
        return None

    def _free(self, point: Point, newton: Step) -> np.ndarray:
        """Parameters (k,) that move: those on a bound stay there if the quadratic model leads out of it."""
        size = newton.dp * np.sqrt(np.diag(newton.information))
        low, high = self.objective.problem.bounds(point.values)
        stays = (point.values <= low) & (size < BOUND_STEP) | (point.values >= high) & (size > -BOUND_STEP)
        return ~self.objective.problem.held_mask & ~stays

    def _explain_divergence(self, cost: float) -> str:
        """A loss that grew, in words."""
        descent = self.descent
        size = "is not finite"
        if np.isfinite(cost):
            size = f"grew from {self.first:.3g} to {cost:.3g}"
        advice = "Use a smaller one"
        if descent.rate > descent.usual_rate:
            advice = f"Use {descent.usual_rate:g}"
        steps = f"{self.taken} steps of {descent.name}"
        return f"the loss {size} after {steps} with learning rate {descent.rate:g}. {advice}"

    def _next(self, x: Coordinates, point: Point, system: Normal, newton: Step) -> Point | None:
        """The next point; None if a line search finds none."""
        direction = x.step(point.values, newton.gradient)
        low, high = self.objective.problem.bounds(point.values)
        span = np.where(direction > 0, high, low) - point.values
        ahead = (direction != 0) & (span != 0)
        direction = np.where(ahead, direction, 0.0) * np.min(span[ahead] / direction[ahead], initial=1.0)
        slope = newton.gradient @ direction
        trials = 1
        if self.descent.searches:
            trials = SEARCH_TRIALS
            if not slope < 0:
                return None
            # the first trial is not beyond the minimum that the information predicts along the direction
            direction = direction * min(-slope / max(direction @ newton.information @ direction, 1e-300), 1.0)
            slope = newton.gradient @ direction
        for trial in range(trials):
            # starts follow the parameters; a shorter step also withholds more of their own move
            damping = self.damping * 10.0**trial
            part = SEARCH_FACTOR**trial
            found = self._moved(point, system, part * direction, damping)
            most = np.inf
            if self.descent.searches:
                most = point.cost + SUFFICIENT_DECREASE * part * slope
            if found is not None and found.cost <= most:
                return self._accepted(found, damping)
        # far from the minimum of the starts a step of the parameters changes the loss by less than the starts do
        found = self._moved(point, system, 0 * direction, self.damping)
        if found is not None and found.cost < point.cost:
            return self._accepted(found, self.damping)
        return None

    def _moved(self, point: Point, system: Normal, change: np.ndarray, damping: float) -> Point | None:
        """The point after a change (k,) of the parameters, which the starts follow; None if they cannot."""
        objective = self.objective
        problem = objective.problem
        nowhere = 0 * point.values
        self.count += 1
        step = objective.solve(system, point.values, damping, nowhere, nowhere)
        if step is None:
            return None
        values = np.clip(point.values + change, *problem.bounds(point.values))
        dz = step.dz + step.eliminated @ (values - point.values)
        evaluation = problem.evaluate(values, problem.move_starts(point.evaluation.starts, point.values, dz))
        return Point(values, evaluation, objective.cost(evaluation, values), None)

    def _accepted(self, found: Point, damping: float) -> Point:
        """The point with its equations, if its loss is finite."""
        self.damping = max(0.1 * damping, LEAST_DAMPING)
        if not np.isfinite(found.cost):
            return found
        return found._replace(system=self.objective.system(found.evaluation, found.values))
