"""`fit_channels`: from named channels of measurement and a scene to parameters with honest errors."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.progress import Progress, silent
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene
from dropper_jax.run.build import SceneLike, build_model
from fitting.channels.between import between
from fitting.channels.data import Data, read_data
from fitting.channels.descent import Point, descend, room, scales_of, stand
from fitting.channels.errors import errors_of
from fitting.channels.free import adjusted, find_free
from fitting.channels.noise import first_noise, told
from fitting.channels.problem import Evaluation, Problem, first_near
from fitting.channels.result import ChannelFit
from fitting.estimate.loss import LEAST_SQUARES, Loss, begun_with, loss_of
from fitting.estimate.normal_equations import bounded_step
from fitting.estimate.refinement import LARGEST_BIAS
from fitting.parameters.naming import default_free, full_names
from fitting.parameters.parameter import Bounds, Parameter, Priors, StartValues, with_effects
from fitting.parameters.priors import rig_priors

#: Rounds of fit and noise, and the change of a size below which another fit would change nothing.
ROUNDS, SAME = 4, 0.03
#: Most halvings of the step for its bias.
MOST_HALVED = 2
#: Growth of the derivatives from the middle of a run to its end above which it is called chaotic.
CHAOTIC = 10.0
#: The same above which the step is taken to be too long.
UNSTABLE = 1e3


def fit_channels(
    data: str | Path | Mapping[str, Any] | Data,
    scene: SceneLike,
    free: Sequence[str] | None = None,
    *,
    own: Sequence[str] = (),
    start: StartValues | None = None,
    bounds: Bounds | None = None,
    priors: Priors | None = None,
    dt: float | None = None,
    integrator: str | None = None,
    huber: float | None = None,
    student: bool = False,
    iterations: int = 40,
    check_step: bool = True,
    progress: Progress | None = None,
) -> ChannelFit:
    """Fit parameters of any scene to named channels: one uninterrupted run of each data file, from the scene's start.

        minimise 1/2 sum ((offset + gain y(t) - measured)/sigma)^2 + priors

    by Levenberg and Marquardt's method with exact derivatives; sigma of every channel is told anew by the residuals.

    Args:
        data: the data's file (`data`), the same as plain values, or what `read_data` made of it.
        scene: packaged name, TOML file, plain values or a `Scene`; its values are the start values.
        free: paths (see `free`); default: what the scene's `[fit]` leaves open, else its damping.
        own: those of them that each run has for itself; their mean and spread over the runs are told too.
        start, bounds, priors: by name: start value; (low, high); (mean, standard deviation).
        dt: time step [s]; default: the scene's.
        integrator: scheme; default: the scene's.
        huber, student: robust losses, as `fit`.
        iterations: most evaluations of each descent.
        check_step: whether half the step is tried, to tell (and mend) how far the step moves the estimates.
        progress: called with (fraction, text).

    Raises:
        SceneError: for anything the caller can mend, in one line.
    """
    begun, progress = time.perf_counter(), progress or silent
    if iterations < 1:
        raise SceneError(f"iterations: {iterations} is none; allowed: at least 1")
    scene = load_scene(scene)
    changed = {"run.dt": dt, "run.integrator": integrator}
    scene = scene.with_values({key: value for key, value in changed.items() if value is not None})
    problem = pose(data, scene, free, own, start or {}, bounds or {}, priors or {})
    loss = loss_of(huber, student)
    progress(0.0, "first run")
    point = first_point(problem, begun_with(loss))
    point = settle_noise(point, iterations, lambda share, text: progress(0.7 * share, text))
    if point.status == "ok" and point.loss != loss:
        again = stand(point.problem, point.values, point.evaluation, point.noise, point.scales, loss)
        again.iterations = point.iterations
        point = settle_noise(again, iterations, progress)
    bias = None
    if check_step and point.status == "ok":
        point, bias = refine(point, iterations, lambda share, text: progress(0.7 + 0.25 * share, text))
    result = ChannelFit(scene, point, errors_of(point), bias)
    result.between = over_runs(result, own)
    result.warnings = warnings_of(result)
    result.seconds = time.perf_counter() - begun
    progress(1.0, result.status)
    return result


def pose(
    source: str | Path | Mapping[str, Any] | Data,
    scene: Scene,
    free: Sequence[str] | None,
    own: Sequence[str],
    start: StartValues,
    bounds: Bounds,
    priors: Priors,
) -> Problem:
    """The problem of these data and this scene.

    Raises:
        SceneError: names, channels, places or numbers that do not fit together.
    """
    names = [name.strip() for name in (default_free(scene) if free is None else free)]
    mine = [name.strip() for name in own]
    known = [n for n in [*names, *mine] if n.split(".")[0] not in ("start", "channel", "camera")]
    scene = with_effects(scene, full_names(scene, known)) if known else scene
    data = source if isinstance(source, Data) else read_data(source, scene)
    if mine and len(data.runs) < 2:
        raise SceneError(f"own: {mine[0]!r} of one run alone; allowed: with 2 runs or more")
    scenes = []
    for run in data.runs:
        try:
            scenes.append(scene.with_values(run.own) if run.own else scene)
        except SceneError as error:
            raise SceneError(f"run {run.name!r}: {error}") from None
    if len({(s.run.dt, s.run.integrator, s.run.save_every) for s in scenes}) > 1:
        raise SceneError("run.scene: runs with other steps or schemes cannot be fitted together; allowed: one [run]")
    _check_program(scenes, data)
    full = lambda name: full_names(scenes[0], [name])[0]  # noqa: E731
    shared = find_free(scenes[0], data, [n for n in names if n not in mine])
    split = find_free(scenes[0], data, mine, "own")
    for p in split:
        if p.name in [q.name for q in shared]:
            raise SceneError(f"own: {p.name!r} is shared too; allowed: one of the two")
    if not shared and not split:
        raise SceneError("free: nothing is free; allowed: paths of parameters")
    parameters, known_together = rig_priors(scenes[0], build_model(scenes[0]), shared)
    parameters = list(adjusted(parameters, *(_of(given, shared, full) for given in (start, bounds, priors)), full))
    split = adjusted(split, *(_of(given, split, full) for given in (start, bounds, priors)), full)
    _all_known(start, bounds, priors, [*shared, *split], full)
    plain, of_run = [], []
    for run in data.runs:
        first = len(parameters)
        parameters += [replace(p, name=f"{p.name}@{run.name}") for p in split]
        plain.append((*shared, *split))
        of_run.append((*range(len(shared)), *range(first, first + len(split))))
    for p in parameters:
        if not p.low <= p.value <= p.high:
            raise SceneError(f"start: {p.name} = {p.value:g} is out of bounds; allowed: {p.low:g} to {p.high:g}")
    if split:  # priors of several are of the shared alone
        wide = lambda a: np.concatenate([a, np.zeros(len(parameters) - len(a))])  # noqa: E731
        together = tuple(replace(c, share=wide(c.share)) for c in known_together.common)
        massive = None if known_together.massive is None else wide(known_together.massive)
        known_together = replace(known_together, common=together, massive=massive)
    near = tuple(first_near(s) for s in scenes)
    return Problem(data, tuple(scenes), tuple(parameters), tuple(of_run), tuple(plain), near, known=known_together)


def _check_program(scenes: Sequence[Scene], data: Data) -> None:
    """Refuse runs that end before anything is seen."""
    spacing = scenes[0].run.dt * scenes[0].run.save_every
    for run in data.runs:
        last = max(float(t[-1]) for t in run.t)
        if last <= 2 * spacing:
            raise SceneError(f"run {run.name!r}: ends at {last:g} s; allowed: more than 2 saved steps of {spacing:g} s")


def _of(given: Mapping[str, Any], parameters: Sequence[Parameter], full: Any) -> dict[str, Any]:
    """What is given by name of these parameters."""
    known = [p.name for p in parameters]
    found = {}
    for name, value in given.items():
        if any(p == name or p.startswith(name + ".") for p in known):
            found[name] = value
        elif name.split(".")[0] not in ("start", "channel", "camera"):
            long = full(name)
            if any(p == long or p.startswith(long + ".") for p in known):
                found[long] = value
    return found


def _all_known(start: StartValues, bounds: Bounds, priors: Priors, parameters: Sequence[Parameter], full: Any) -> None:
    for which, given in (("start", start), ("bounds", bounds), ("prior", priors)):
        for name in given:
            if not _of({name: 0}, parameters, full):
                raise SceneError(f"{which}: {name!r} is not free; {nearest(name, [p.name for p in parameters])}")


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


def over_runs(result: ChannelFit, own: Sequence[str]) -> tuple[Any, ...]:
    """Mean and spread of every parameter that runs have for themselves."""
    problem = result.point.problem
    runs = [run.name for run in problem.data.runs]
    names = [p.name for p in problem.parameters]
    stems = dict.fromkeys(n.rsplit("@", 1)[0] for n in names if "@" in n) if own else {}
    found = []
    for stem in stems:
        index = [names.index(f"{stem}@{run}") for run in runs]
        found.append(between(stem, result.values[index], result.errors.covariance[np.ix_(index, index)]))
    return tuple(found)


def warnings_of(result: ChannelFit) -> list[str]:
    """What to beware of, one line each."""
    found, point, e = [], result.point, result.errors
    for p, kind, why in zip(result.parameters, e.determined, e.why, strict=True):
        if kind == "no":
            found.append(f"{p.name}: not determined: {why}")
        elif kind != "yes":
            found.append(f"{p.name}: {kind}: {why}")
    for p, bound in zip(result.parameters, e.at_bound, strict=True):
        if bound:
            found.append(f"{p.name}: at its bound")
    for row in result.channels():
        claimed, told_ = row["noise_claimed"], row["noise"]
        if claimed is not None and not 0.5 < told_ / claimed < 2:
            found.append(f"channel {row['name']}: residuals are {told_ / claimed:.2g} times the noise of its sensor")
    if e.blocks:
        worst = point.problem.data.sensors[int(np.abs(e.correlation).argmax())].channel.name
        found.append(f"channel {worst}: residuals are no noise; errors come from {e.blocks} blocks of time")
    grown = growth(point.evaluation)
    if grown > CHAOTIC:
        found.append(f"the motion is chaotic: derivatives grow {grown:.2g} times in half the run; cut it shorter")
    bias = None if result.step_bias is None else float(np.nanmax(np.abs(result.step_bias), initial=0.0))
    if bias is not None and bias > LARGEST_BIAS:
        found.append(f"the step of {point.problem.dt:g} s moves the estimates by {bias:.2g} standard errors; take less")
    return found


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
