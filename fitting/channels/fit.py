"""`fit_channels`: from named channels of measurement and a scene to calibrated parameters with error estimates."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, pairwise
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, part_of, silent
from dropper_jax.base.read import Values
from dropper_jax.load.scene import load_scene
from dropper_jax.modelling.build import SceneLike
from fitting.channels.between_runs import over_runs
from fitting.channels.data import ChannelData, Series
from fitting.channels.errors import VERDICTS, estimate_errors
from fitting.channels.make_problem import make_problem
from fitting.channels.problem import MOST_HALVED, ChannelSolution, Evaluation, Problem
from fitting.channels.result import ChannelFit
from fitting.estimate.least_squares import continue_fit, first_solution
from fitting.estimate.loss import LEAST_SQUARES, Loss, as_loss, initial_loss
from fitting.estimate.noise_rounds import NOISE_ROUNDS, fit_with_noise
from fitting.estimate.residual_noise import transfer_solution
from fitting.estimate.scene_fit import common_warnings
from fitting.estimate.step_size import refine
from fitting.parameters.parameter import Bounds, Priors, StartValues

#: Residuals above this multiple of the sensor's noise, of which more than this fraction is kept from sample to sample,
#: are those of a model, such as a rope of 12 links in place of 24 (1.7 and 0.7) or a bending stiffness 5 % off.
LARGE_RESIDUAL_RATIO = 1.25
SMOOTH_MEMORY = 0.5
#: Ratio of the residuals to the sensor's noise, in either direction, from which there is a warning.
OTHER_NOISE_RATIO = 2.0
#: A step may leave ringing that stays small, but whose derivatives look like those of a chaotic motion.
LARGEST_GROWTH = 1e3
#: Growth of derivatives from the middle of a run to its end above which there is a warning.
CHAOTIC_GROWTH = 10.0
#: Errors of 3 % of the noise of several channels move estimates by 0.02 standard errors relative to each other.
NOISE_TOLERANCE = 0.01


def fit_channels(
    data: str | Path | Values | ChannelData,
    scene: SceneLike,
    free: Sequence[str] | None = None,
    *,
    own: Sequence[str] = (),
    start: StartValues | None = None,
    bounds: Bounds | None = None,
    priors: Priors | None = None,
    loss: Loss | str = LEAST_SQUARES,
    iterations: int = 40,
    check_step: bool = True,
    progress: Progress | None = None,
) -> ChannelFit:
    """Fit parameters of any scene to named channels: one uninterrupted run of each data file, from the scene's start.

        minimise 1/2 sum ((offset + gain y(t) - measured)/sigma)^2 + priors

    by the Levenberg-Marquardt method with exact derivatives; sigma of every channel is re-estimated from the residuals.

    Args:
        data: the data's file (`reading`), the same as plain values, or the result of `read_data`.
        scene: packaged name, TOML file, plain values or a `Scene`; its values are the start values, and its `[run]`
            gives time step and scheme.
        free: paths (see `setup`); default: those listed in the scene's `[fit]`, otherwise its damping.
        own: those of them that each run has separately; their mean and spread over the runs are reported too.
        start, bounds, priors: by name: start value; (low, high); (mean, standard deviation).
        loss: as for `fit`.
        iterations: maximum evaluations of each descent.
        check_step: whether half the step is tried, to report (and correct) the shift of the estimates by the step.
        progress: called with (fraction, text).

    Raises:
        SceneError: for any invalid input, in one line.
    """
    started = time.perf_counter()
    progress = progress or silent
    if iterations < 1:
        raise SceneError(f"iterations: {iterations} is too small; allowed: at least 1")
    loss = as_loss(loss)
    scene = load_scene(scene).with_equal_steps()
    problem = make_problem(data, scene, free, own, start or {}, bounds or {}, priors or {})
    progress(0.0, "first run")
    point = first_point(problem, initial_loss(loss))
    point = settle_noise(point, iterations, part_of(progress, 0.0, 0.5))
    if point.status == "ok" and point.problem.loss != loss:
        point = transfer_solution(point, replace(point.problem, loss=loss), point.evaluation)
        point = settle_noise(point, iterations, part_of(progress, 0.5, 0.7))
    if check_step and point.status == "ok":
        say = part_of(progress, 0.7, 0.95)

        def fit_again(ahead: ChannelSolution) -> ChannelSolution:
            return settle_noise(replace(ahead, iterations=0), iterations, say)

        # the interval of saved states, used by the cubics, stays the same
        point = refine(point, say, fit_again, sure=0.0)
    result = ChannelFit(scene=scene, solution=point, uncertainty=estimate_errors(point))
    result.between = over_runs(point.problem, result.values, result.errors.covariance)
    result.warnings = warnings_of(result)
    result.seconds = time.perf_counter() - started
    progress(1.0, result.status)
    return result


def warnings_of(result: ChannelFit) -> list[str]:
    """Warnings, one line each."""
    point = result.solution
    e = result.errors
    found = common_warnings(point, e)
    for p, determined, why in zip(result.parameters, e.determined, e.why, strict=True):
        if determined == "no":
            determined = VERDICTS["no"]
        if determined != "yes":
            found.append(f"{p.name}: {determined}: {why}")
    for row in result.channels():
        if row["noise_claimed"] is None:
            continue
        ratio = row["noise"] / row["noise_claimed"]
        times = f"channel {row['name']}: residuals are {ratio:.2g} times the noise of its sensor"
        if not 1 / OTHER_NOISE_RATIO < ratio < OTHER_NOISE_RATIO:
            found.append(times)
        elif ratio > LARGE_RESIDUAL_RATIO and row["kept"] > SMOOTH_MEMORY:
            found.append(
                f"{times} and keep {row['kept']:.0%} from sample to sample: the model misses part of the motion. Try "
                "more links and a smaller step"
            )
    if e.blocks:
        worst = point.problem.data.sensors[np.abs(e.correlation_1).argmax()].channel.name
        found.append(f"channel {worst}: residuals are correlated; errors come from {e.blocks} blocks of time")
    grown = growth(point.evaluation)
    if grown > CHAOTIC_GROWTH:
        found.append(f"the motion is chaotic: derivatives grow {grown:.2g} times in half the run. Use shorter runs")
    return found


def first_point(problem: Problem, loss: Loss = LEAST_SQUARES) -> ChannelSolution:
    """The start of the fit.

    Raises:
        SceneError: the run at the start values does not solve, also with halved steps where needed.
    """
    values = problem.values
    e = problem.evaluate(values)
    if e.failed and not e.unstable:
        problem = replace(problem, retries=True)
        e = problem.evaluate(values)
    while (e.unstable or not e.failed) and growth(e) > LARGEST_GROWTH and problem.halved < MOST_HALVED:
        problem = problem.finer()
        e = problem.evaluate(values)
    if e.failed:
        hint = ""
        if e.unstable:
            hint = ", --integrator generalized_alpha (which damps the ringing of stiff lines)"
        raise SceneError(
            f"start: the run at the start values fails, {e.failed}. Try a smaller --dt{hint}, or other values"
        )
    return first_solution(replace(problem, loss=loss), values, e)


def settle_noise(point: ChannelSolution, iterations: int, progress: Progress = silent) -> ChannelSolution:
    """Alternate fit and noise estimate up to their common fixed point."""
    shares = pairwise(np.linspace(0.0, 1.0, NOISE_ROUNDS + 3))  # of at most two more descents than rounds

    def descend(point: ChannelSolution) -> ChannelSolution:
        return continue_fit(point, iterations, part_of(progress, *next(shares)))

    def claimed_series(point: ChannelSolution) -> Series:
        return point.problem.data.series(point.problem.claimed_noise, point.evaluation.shown)

    found = descend(point)
    found = replace(found, iterations=found.iterations + point.iterations)
    floor = (point.problem.floor / point.problem.claimed_noise)[:, None]
    found = fit_with_noise(found, descend, claimed_series, floor, tolerance=NOISE_TOLERANCE)
    if found.status != "ok":
        return found
    ended = descend(found)  # no steps if the last noise moves no parameter
    return replace(ended, iterations=ended.iterations + found.iterations)


def growth(e: Evaluation) -> float:
    """Ratio of the derivatives in the last fifth of the samples to those in the middle one; inf if not finite."""
    most = 0.0
    for slopes in chain(*e.slopes):
        if not np.isfinite(slopes).all():
            return np.inf
        n = len(slopes)
        middle = np.abs(slopes[2 * n // 5 : 3 * n // 5]).max(axis=(0, 1), initial=0.0)
        last = np.abs(slopes[4 * n // 5 :]).max(axis=(0, 1), initial=0.0)
        most = max(most, (last[middle > 0] / middle[middle > 0]).max(initial=0.0))
    return most
