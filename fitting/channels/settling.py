"""From start values to a settled point: the first run, fit and noise in turns, half the step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from fitting.channels.descent import Point, descend, room, scales_of, stand
from fitting.channels.errors import errors_of
from fitting.channels.noise import first_noise, told
from fitting.channels.problem import Evaluation, Problem
from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.normal_equations import bounded_step
from fitting.estimate.refinement import LARGEST_BIAS

#: Rounds of fit and noise, and the change of a size below which another fit would change nothing.
ROUNDS, SAME = 4, 0.03
#: Most halvings of the step for its bias.
MOST_HALVED = 2
#: The same above which the step is taken to be too long.
UNSTABLE = 1e3


def floors_of(problem: Problem) -> np.ndarray:
    """Least noise of each channel (c,) that is believed: its sensor's rounding, `resolution/sqrt(12)`."""
    fit = problem.scenes[0].fit
    found = []
    for sensor in problem.data.sensors:
        least = 0.0 if fit is None or sensor.relative else fit.resolution(sensor.channel.kind) / np.sqrt(12)
        found.append(max(least, 1e-15))
    return np.array(found)


def first_point(problem: Problem, loss: Loss = LEAST_SQUARES) -> Point:
    """Where the fit starts.

    Raises:
        SceneError: the start values' run does not solve, also with steps that are halved where they resist.
    """
    values = problem.values
    e = problem.evaluate(values)
    if e.failed and not e.unstable:
        problem = replace(problem, retries=True)
        e = problem.evaluate(values)
    # a step may leave ringing that stays small, of which the derivatives are a chaotic motion's
    while (e.unstable or not e.failed) and growth(e) > UNSTABLE and problem.halved < MOST_HALVED:
        problem = problem.finer()
        e = problem.evaluate(values)
    if e.failed:
        hint = ", --integrator generalized_alpha (which lets stiff lines not ring)" if e.unstable else ""
        raise SceneError(
            f"start: the run at the start values fails, {e.failed}; allowed: a smaller --dt{hint}, other values"
        )
    return stand(problem, values, e, first_noise(problem.data, floors_of(problem)), scales_of(problem, e), loss)


def settle_noise(point: Point, iterations: int, progress: Progress = silent) -> Point:
    """Fit and noise at their common fixed point."""
    floors = floors_of(point.problem)
    for turn in range(ROUNDS):
        say = lambda share, text, turn=turn: progress((turn + share) / ROUNDS, text)  # noqa: E731
        point = descend(point, iterations, say)
        problem, e = point.problem, point.evaluation
        scales = scales_of(problem, e)
        free = ~problem.held
        information = point.information[np.ix_(free, free)]
        seen = e._replace(slopes=tuple(tuple(s[..., free] for s in run) for run in e.slopes))
        noise = told(problem.data, seen, point.noise, scales, information, floors, point.loss)
        apart = np.abs(np.log(noise.size / point.noise.size)).max()
        same = np.array_equal(noise.decay > 0, point.noise.decay > 0) and apart < SAME
        again = stand(problem, point.values, e, noise, scales, point.loss)
        again.iterations, again.history = point.iterations, point.history
        again.status, again.message, point = point.status, point.message, again
        if same or point.status != "ok":
            return point
    return point


def refine(point: Point, iterations: int, progress: Progress = silent) -> tuple[Point, np.ndarray | None]:
    """Look at what half the step would do, and go on with it where that is no small part of a standard error."""
    bias = None
    for _ in range(MOST_HALVED + 1):
        bias, ahead = step_bias(point)
        if ahead is None or not np.max(np.abs(bias), initial=0.0) > LARGEST_BIAS:
            break
        if point.problem.halved == MOST_HALVED:
            break
        progress(0.0, f"the step's bias is {np.max(np.abs(bias)):.2g} standard errors: half of it")
        ahead.iterations = point.iterations
        on = settle_noise(ahead, iterations, progress)
        if on.status != "ok":
            break
        point = on
    return point, bias


def step_bias(point: Point) -> tuple[np.ndarray, Point | None]:
    """How far the step moves the estimates (p,) [standard errors], and the fit's point with half the step."""
    problem = point.problem.finer()
    e = problem.evaluate(point.values, point.evaluation.near)
    none = np.full(len(point.values), np.nan)
    if e.failed:
        return none, None
    ahead = stand(problem, point.values, e, point.noise, scales_of(problem, e), point.loss)
    low, high = room(problem, point.values)
    step = bounded_step(ahead.information, ahead.gradient, low, high) - bounded_step(
        point.information, point.gradient, low, high
    )
    order = problem.plan(0).stepper.integrator.order
    errors = errors_of(point).std_error
    return -step / (1 - 0.5**order) / np.where(errors > 0, errors, np.inf), ahead


def growth(e: Evaluation) -> float:
    """How much larger derivatives are in the last fifth of the samples than in the middle one; inf where not finite."""
    most = 0.0
    for run in e.slopes:
        for slopes in run:
            if not np.isfinite(slopes).all():
                return np.inf
            n = len(slopes)
            ends = (slice(2 * n // 5, 3 * n // 5), slice(4 * n // 5, n))
            middle, last = (np.abs(slopes[part]).max(axis=(0, 1), initial=0.0) for part in ends)
            most = max(most, float((last[middle > 0] / middle[middle > 0]).max(initial=0.0)))
    return most
