"""`fit_channels`: from named channels of measurement and a scene to calibrated parameters with error estimates."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, count
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import Progress, SceneError, part_of, silent
from dropper_jax.base.read import ScenePath, Values
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.run.build import SceneLike, build_model, initial_state
from fitting.channels.data import Data, Series
from fitting.channels.problem import MOST_HALVED, ChannelSolution, Evaluation, Problem
from fitting.channels.reading import read_data
from fitting.channels.result import VERDICTS, Between, ChannelFit, combine_runs, estimate_errors
from fitting.channels.setup import find_free
from fitting.estimate.least_squares import continue_fit, first_solution
from fitting.estimate.loss import LEAST_SQUARES, Loss, as_loss, initial_loss
from fitting.estimate.noise_rounds import NOISE_ROUNDS, fit_with_noise
from fitting.estimate.residual_noise import transfer_solution
from fitting.estimate.scene_fit import common_warnings
from fitting.estimate.step_size import refine
from fitting.parameters.names import by_full_path, default_free, full_names
from fitting.parameters.parameter import Bounds, Priors, StartValues, adjust_parameters, with_zero_damping
from fitting.parameters.rig_priors import JointPrior, rig_priors

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
#: Sections of paths that do not belong to the scene's model.
DATA_SECTIONS = ("start", "channel", "camera")


def make_problem(
    source: str | Path | Values | Data,
    scene: Scene,
    free: Sequence[str] | None,
    own: Sequence[str],
    start: StartValues,
    bounds: Bounds,
    priors: Priors,
) -> Problem:
    """The problem of these data and this scene.

    Raises:
        SceneError: names, channels, positions or numbers that do not fit together.
    """
    if free is None:
        free = default_free(scene)
    names = [name.strip() for name in free]
    mine = [name.strip() for name in own]
    of_scene = [name for name in (*names, *mine) if ScenePath(name).section not in DATA_SECTIONS]
    if of_scene:
        scene = with_zero_damping(scene, full_names(scene, of_scene))
    data = source if isinstance(source, Data) else read_data(source, scene)
    if mine and len(data.runs) < 2:
        raise SceneError(f"own: {mine[0]!r}: there is only one run. Use it with 2 runs or more")
    scenes = _scenes_of_runs(scene, data)
    _check_spacing(scenes[0], data)
    shared = find_free(scenes[0], data, [n for n in names if n not in mine])
    split = find_free(scenes[0], data, mine, "own")
    for p in split:
        if p.name in [q.name for q in shared]:
            raise SceneError(f"own: {p.name!r} is also shared; allowed: one of the two")
    if not shared and not split:
        raise SceneError("free: nothing is free; allowed: paths of parameters")
    with_priors, known = rig_priors(scenes[0], build_model(scenes[0]), shared)
    given = by_full_path(scenes[0], start, bounds, priors, DATA_SECTIONS)
    every = adjust_parameters([*with_priors, *split], *given, wider=True)
    parameters = list(every[: len(shared)])
    split = every[len(shared) :]
    of_run = []
    for run in data.runs:
        first = len(parameters)
        parameters += [replace(p, name=f"{p.name}@{run.name}") for p in split]
        of_run.append((*range(len(shared)), *range(first, len(parameters))))
    return Problem(
        data=data,
        scenes=scenes,
        parameters=tuple(parameters),
        of_run=tuple(of_run),
        plain=(*shared, *split),
        near=tuple(initial_state(build_model(s), s.start) for s in scenes),
        known=_pad_prior(known, len(parameters)),
    )


def _scenes_of_runs(scene: Scene, data: Data) -> tuple[Scene, ...]:
    """The scene with the own values of each run.

    Raises:
        SceneError: values that the scene does not have, or that change the step or the scheme.
    """
    scenes = []
    for run in data.runs:
        try:
            scenes.append(scene.with_values(run.own) if run.own else scene)
        except SceneError as error:
            raise SceneError(f"run {run.name!r}: {error}") from None
    if len({(s.run.step, s.run.integrator, s.run.save_every) for s in scenes}) > 1:
        raise SceneError("run.scene: runs with other steps or schemes cannot be fitted together. Use one [run]")
    return tuple(scenes)


def _pad_prior(known: JointPrior, count: int) -> JointPrior:
    """The joint prior of the shared parameters, for all `count` of them, of which the last it does not concern."""
    common = []
    for one in known.common:
        common.append(replace(one, share=np.pad(one.share, (0, count - len(one.share)))))
    massive = known.massive
    if massive is not None:
        massive = np.pad(massive, (0, count - len(massive)))
    return replace(known, common=tuple(common), massive=massive)


def _check_spacing(scene: Scene, data: Data) -> None:
    """Reject saved states that are too far apart for a run, or for the differences of an inertial sensor.

    The samples of such a sensor are assumed to follow the motion: states at their interval give its derivatives to 1 %
    at six samples per period and to 0.02 % at fifteen.
    """
    spacing = scene.run.step * scene.run.save_every
    for run in data.runs:
        last = max(float(t[-1]) for t in run.t)
        if last <= 2 * spacing:
            raise SceneError(f"run {run.name!r}: ends at {last:g} s; allowed: more than 2 saved steps of {spacing:g} s")
    for c, sensor in enumerate(data.sensors):
        interval = min(float(np.median(np.diff(run.t[c]))) for run in data.runs)
        if sensor.channel.margin and spacing > interval * (1 + 1e-6):
            most = max(1, int(interval / scene.run.step))
            raise SceneError(
                f"run.save_every: {spacing:g} s between saved states, but channel {sensor.channel.name!r} has a sample "
                f"every {interval:g} s; allowed: save_every up to {most} with steps of at most {interval:g} s"
            )


def fit_channels(
    data: str | Path | Values | Data,
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
    point = settle_noise(point, iterations, part_of(progress, 0.0, 0.7))
    if point.status == "ok" and point.problem.loss != loss:
        point = transfer_solution(point, replace(point.problem, loss=loss), point.evaluation)
        point = settle_noise(point, iterations, progress)
    if check_step and point.status == "ok":
        say = part_of(progress, 0.7, 0.95)

        def fit_again(ahead: ChannelSolution) -> ChannelSolution:
            return settle_noise(replace(ahead, iterations=0), iterations, say)

        # the interval of saved states, used by the cubics, stays the same
        point = refine(point, say, fit_again, sure=0.0)
    result = ChannelFit(scene=scene, solution=point, uncertainty=estimate_errors(point))
    result.between = over_runs(result)
    result.warnings = warnings_of(result)
    result.seconds = time.perf_counter() - started
    progress(1.0, result.status)
    return result


def over_runs(result: ChannelFit) -> tuple[Between, ...]:
    """Mean and spread of every parameter that runs have separately."""
    problem = result.solution.problem
    found = []
    for p, numbers in zip(problem.plain, np.transpose(problem.of_run), strict=True):
        if numbers[0] != numbers[-1]:  # the runs do not share it
            covariance = result.errors.covariance[np.ix_(numbers, numbers)]
            found.append(combine_runs(p.name, result.values[numbers], covariance))
    return tuple(found)


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
        worst = point.problem.data.sensors[int(np.abs(e.correlation_1).argmax())].channel.name
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
    turns = count()

    def descend(point: ChannelSolution) -> ChannelSolution:
        turn = next(turns)  # at most ROUNDS and two more
        return continue_fit(
            point, iterations, part_of(progress, turn / (NOISE_ROUNDS + 2), (turn + 1) / (NOISE_ROUNDS + 2))
        )

    def claimed_series(point: ChannelSolution) -> Series:
        return point.problem.data.series(point.problem.claimed_noise, point.evaluation.shown)

    found = descend(point)
    found.iterations += point.iterations
    floor = (point.problem.floor / point.problem.claimed_noise)[:, None]
    found = fit_with_noise(found, descend, claimed_series, floor, tolerance=NOISE_TOLERANCE)
    if found.status != "ok":
        return found
    ended = descend(found)  # no steps if the last noise moves no parameter
    ended.iterations += found.iterations
    return ended


def growth(e: Evaluation) -> float:
    """Ratio of the derivatives in the last fifth of the samples to those in the middle one; inf if not finite."""
    most = 0.0
    for slopes in chain(*e.slopes):
        if not np.isfinite(slopes).all():
            return np.inf
        n = len(slopes)
        middle = np.abs(slopes[2 * n // 5 : 3 * n // 5]).max(axis=(0, 1), initial=0.0)
        last = np.abs(slopes[4 * n // 5 :]).max(axis=(0, 1), initial=0.0)
        most = max(most, float((last[middle > 0] / middle[middle > 0]).max(initial=0.0)))
    return most
