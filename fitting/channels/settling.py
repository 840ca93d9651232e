"""From start values to a settled fit: the first run, then fit and noise in turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from fitting.channels.noise import Evaluation, first_noise, scale_of, told
from fitting.channels.problem import MOST_HALVED, Problem
from fitting.estimate.gauss_newton import continue_windows, first_solution
from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.own_noise import ROUNDS, fit_with_noise, posed
from fitting.estimate.problem import Solution

#: Growth of derivatives above which the step is taken to be too long.
UNSTABLE = 1e3


def scales_of(problem: Problem, e: Evaluation) -> tuple[tuple[np.ndarray, ...], ...]:
    """By what the channels' sizes of noise count."""
    return tuple(
        tuple(scale_of(s, shown) for s, shown in zip(problem.data.sensors, run, strict=True)) for run in e.shown
    )


def floors_of(problem: Problem) -> np.ndarray:
    """Least noise of each channel (c,) that is believed: its sensor's rounding, `resolution/sqrt(12)`."""
    fit = problem.scenes[0].fit
    found = []
    for sensor in problem.data.sensors:
        least = 0.0 if fit is None or sensor.relative else fit.resolution(sensor.channel.kind) / np.sqrt(12)
        found.append(max(least, 1e-15))
    return np.array(found)


def first_point(problem: Problem, loss: Loss = LEAST_SQUARES) -> Solution:
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
    noise = first_noise(problem.data, floors_of(problem))
    problem = replace(problem, loss=loss, noise=noise, scales=scales_of(problem, e))
    return first_solution(problem, values, problem.with_rows(e))


def settle_noise(point: Solution, iterations: int, progress: Progress = silent) -> Solution:
    """Fit and noise at their common fixed point."""
    floors, turn = floors_of(point.problem), 0

    def descend(point: Solution) -> Solution:
        nonlocal turn
        say = lambda share, text, turn=turn: progress((turn + share) / (ROUNDS + 2), text)  # noqa: E731
        turn += 1
        return continue_windows(point, iterations, say)

    def estimate_noise(point: Solution) -> tuple[Solution, float]:
        problem, e, free = point.problem, point.evaluation, ~point.problem.held
        seen = e._replace(slopes=tuple(tuple(s[..., free] for s in run) for run in e.slopes))
        scales, information = scales_of(problem, e), point.information[np.ix_(free, free)]
        noise = told(problem.data, seen, problem.noise, scales, information, floors, problem.loss)
        problem = replace(problem, noise=noise, scales=scales)
        return posed(point, problem, problem.with_rows(e)), noise.apart(point.problem.noise)

    found = descend(point)
    found.iterations += point.iterations
    if found.status != "ok":
        return estimate_noise(found)[0]
    # sizes of several channels that are 3 % off move estimates by 0.02 standard errors against each other
    found = fit_with_noise(found, estimate_noise, descend, same=0.01)
    ended = descend(found)  # nothing where the last noise moves no parameter
    ended.iterations += found.iterations
    return ended


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
