"""The stages before any estimate: traces are read and checked, samples chosen, windows cut and their starts found."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from dropper_jax import load_scene
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.progress import Progress, silent
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.modelling.build import SceneLike, build
from fitting.estimate.normal_equations import Evaluation
from fitting.estimate.release import Release, release_of
from fitting.estimate.rest import rests
from fitting.estimate.simulator import Simulator, choose_stepper
from fitting.estimate.windows import Starts, Windows
from fitting.parameters.missing_forces import tested_parameters
from fitting.parameters.names import Changes, by_full_path, default_free, default_rig, full_names
from fitting.parameters.parameter import Bounds, Parameter, Priors, StartValues, adjust_parameters, with_zero_damping
from fitting.parameters.recording_delay import convention_distance
from fitting.parameters.recordings import SharedMotion, merge_recordings
from fitting.parameters.rig_priors import rig_priors
from fitting.parameters.scene_parameters import free_of_traces
from fitting.parameters.targets import RECORDING, LostTarget
from fitting.traces.conventions import check_scale, settle_convention
from fitting.traces.noise import noise
from fitting.traces.planar import check_planar, pendulum_period
from fitting.traces.trace import Trace
from fitting.traces.trace_file import as_trace
from fitting.windows.fit_settings import AUTOMATIC, FitSettings
from fitting.windows.prepared import Prepared, Samples, fitted_parts
from fitting.windows.rising_energy import refuse_rising_energy
from fitting.windows.spans import Interval, check_spans, fitted_spans
from fitting.windows.still_spans import advice_on_rest, without_held_starts
from fitting.windows.window_plan import check_step, plan_windows, program_capacity, windows_along_motion
from fitting.windows.wrong_files import refuse_wrong_file

#: One run or several: CSV files or traces.
TracesLike = Sequence[str | Path | Trace] | str | Path | Trace


def at_frames(parameters: Sequence[Parameter], traces: Sequence[Trace]) -> tuple[Parameter, ...]:
    """The parameters with the times of the frames that they refer to.

    Raises:
        SceneError: an unknown run, or a frame without a predecessor.
    """
    timed = list(parameters)
    for i, p in enumerate(timed):
        if isinstance(p.where, LostTarget):
            if p.where.run >= len(traces):
                raise SceneError(f"free: {p.name!r}: unknown run; allowed: 0 to {len(traces) - 1}")
            t = traces[p.where.run].t
            if not 0 < p.where.frame < len(t):
                raise SceneError(f"free: {p.name!r}: unknown frame; allowed: 1 to {len(t) - 1}")
            timed[i] = replace(p, where=replace(p.where, time=float(t[p.where.frame])))
    return tuple(timed)


def prepare(
    traces: TracesLike,
    scene: SceneLike,
    free: Sequence[str] | None = None,
    *,
    start: StartValues | None = None,
    bounds: Bounds | None = None,
    priors: Priors | None = None,
    until: float | None = None,
    held_out: Sequence[Interval] = (),
    settings: FitSettings = AUTOMATIC,
    simulator: Simulator | None = None,
    progress: Progress = silent,
) -> Prepared:
    """Read and check everything, cut windows, find their starts.

    Arguments as in `fit`; `simulator` is an already compiled one from an earlier call with the same scene and
    parameters.
    """
    started = time.perf_counter()
    compiled_before = 0.0
    if simulator is not None:
        compiled_before = simulator.compile_s
    progress(0.0, "reading")
    scene = load_scene(scene)
    names, rig, of_recordings = _free_names(scene, free, settings)
    scene = with_zero_damping(scene, names)
    model, state = build(scene)
    check_planar(model, state)
    read, notes = read_traces(traces, model, settings, names)
    release = None
    if settings.static_start or any(name.startswith("release.") for name in names):
        release = release_of(scene, state, len(read))
    changed = by_full_path(scene, start, bounds, priors, (RECORDING,))
    parameters = free_of_traces(scene, model, [*names, *rig], release)
    if settings.same_motion:
        motion = _same_motion(read, changed.start, settings, release)
        notes += motion.notes
        read = [motion.trace]
        parameters = (*parameters, *parameters_named(motion.parameters, of_recordings))
        changed = _with_found_delays(changed, motion)
    elif of_recordings:
        raise SceneError(f"free: {of_recordings[0]!r}: only for recordings of one motion. Use --same-motion")
    parameters = adjust_parameters(parameters, *changed)
    parameters, known = rig_priors(scene, model, at_frames(parameters, read))
    samples = choose_samples(read, scene, model, until, held_out, settings, release is not None)
    samples = replace(samples, warnings=(*notes, *samples.warnings))
    if simulator is None:
        stepper = choose_stepper(model, settings.integrator, scene.run.solver)
        simulator = Simulator(model, parameters, stepper, release, more=tested_parameters(model, parameters))
    simulator = simulator.view_of(parameters)
    plan = plan_windows(samples, simulator, settings)
    simulator.capacity = program_capacity(samples, plan)
    progress(0.02, f"windows of at most {plan.length:.3g} s: compiling")
    values = np.array([p.value for p in parameters])
    windows, starts, growth = windows_along_motion(samples, simulator, release, plan, values)
    if release is not None:
        parameters = release.bound_times(parameters, windows)
    _check_effective(simulator, simulator(values, starts, windows))
    if release is not None:
        parameters = _from_first_release(release, simulator, parameters, windows, starts)
    return Prepared(
        **vars(samples),
        scene=scene,
        parameters=parameters,
        simulator=simulator,
        windows=windows,
        starts=starts,
        lyapunov=growth,
        started=started,
        compiled_before=compiled_before,
        known=known,
    )


def _same_motion(
    traces: list[Trace], start: StartValues, settings: FitSettings, release: Release | None
) -> SharedMotion:
    """The recordings of one motion.

    Raises:
        SceneError: settings that only separate runs have.
    """
    if release is not None:
        raise SceneError("same-motion: cannot be combined with a static start or release.*. Fit the first recording")
    if settings.rest:
        raise SceneError("same-motion: cannot be combined with rest. Fit the first recording, or leave rest out")
    return merge_recordings(traces, start)


def _with_found_delays(changed: Changes, motion: SharedMotion) -> Changes:
    """What the caller gives, with the delay found near each given one as its start."""
    start = dict(changed.start)
    for p in motion.parameters:
        if p.name.endswith(".delay") and p.name in start:
            start[p.name] = p.value
    return changed._replace(start=start)


def _from_first_release(
    release: Release, simulator: Simulator, parameters: Sequence[Parameter], windows: Windows, starts: Starts
) -> tuple[Parameter, ...]:
    """The parameters with the release times that fit the first windows best as their start values."""
    values = np.array([p.value for p in parameters])
    values = release.guess(lambda *at: simulator(*at).residual, parameters, windows, starts, values)
    return tuple(replace(p, value=float(v)) for p, v in zip(parameters, values, strict=True))


def _check_effective(simulator: Simulator, evaluation: Evaluation) -> None:
    """Reject free parameters that move no traced angle."""
    slopes = evaluation.jacobian[..., simulator.freedoms :]
    for p, effective in zip(simulator.parameters, np.any(slopes, axis=(0, 1, 2)), strict=True):
        if not effective:
            raise SceneError(f"free: {p.name!r} does not affect the traced angles. Use a parameter that does")


def _free_names(
    scene: Scene, free: Sequence[str] | None, settings: FitSettings
) -> tuple[list[str], list[str], list[str]]:
    """Names of the parameters that a user frees, or a scene by default: its own, its rig's, and further recordings'."""
    if free is not None:
        recordings = [name for name in free if name.startswith(f"{RECORDING}.")]
        return full_names(scene, [name for name in free if name not in recordings]), [], recordings
    rig = []
    # a file is checked by the lengths and the zero of the scene, although they are free
    if not (settings.fixed or settings.static_start):
        rig = default_rig(scene)
    return default_free(scene), rig, []


def read_traces(
    traces: TracesLike, model: Model, settings: FitSettings, free: Sequence[str]
) -> tuple[list[Trace], list[str]]:
    """The traces in the model's convention, checked, and notes for the user.

    Args:
        free: names of the parameters that are fitted, without the rig's by default.

    Raises:
        SceneError: files that cannot be read or do not belong to the scene.
    """
    if isinstance(traces, str | Path | Trace):
        traces = [traces]
    if not len(traces):
        raise SceneError("traces: none given. Use one or more CSV files")
    asked = settings.convention
    notes = []
    read = [as_trace(item, model.line.links, settings.columns, settings.same_motion) for item in traces]
    for trace in read:
        check_scale(trace, model, asked)
        notes += refuse_wrong_file(trace, model, asked, free)
    in_model = []
    for trace in read:
        distance = None
        if settings.same_motion and in_model:
            distance = partial(convention_distance, in_model[0])
        converted, more = settle_convention(trace, model, asked, distance)
        in_model.append(converted)
        notes += more
    if settings.dt is not None:
        check_step(in_model, settings.dt)
    return in_model, notes


def parameters_named(parameters: Sequence[Parameter], names: Sequence[str]) -> tuple[Parameter, ...]:
    """The parameters with these names, or that belong to them; all of them without any.

    Raises:
        SceneError: a name that none of them has.
    """
    for name in names:
        if not any(f"{p.name}.".startswith(f"{name}.") for p in parameters):
            raise SceneError(f"free: {name!r} does not exist; {nearest(name, [p.name for p in parameters])}")
    stems = tuple(f"{name}." for name in names)
    return tuple(p for p in parameters if not names or f"{p.name}.".startswith(stems))


def choose_samples(
    traces: list[Trace],
    scene: Scene,
    model: Model,
    until: float | None,
    held_out: Sequence[Interval],
    settings: FitSettings,
    released: bool,
) -> Samples:
    """The samples to fit, to score and to take as poses at rest, with their noise.

    Args:
        released: whether the model gives the start of every run.

    Raises:
        SceneError: spans that contain nothing, or a motion that gains energy.
    """
    held = check_spans(traces, held_out)
    rest = check_spans(traces, settings.rest, "rest")
    spans = fitted_spans(traces, until, sorted([*held, *rest]), settings.begin)
    traces, notes = with_model_error(traces, scene)
    sigma = [np.hypot(noise(trace), trace.model_error) for trace in fitted_parts(traces, spans)]
    traces = [replace(trace, se=trace.total_error) for trace in traces]
    length = np.asarray(model.line.length)
    slowest = pendulum_period(np.sum(length))
    period = pendulum_period(length)
    if not released:
        spans, more = without_held_starts(spans, fitted_parts(traces, spans), sigma, slowest, model)
        notes += more
    for i, trace in enumerate(traces):
        if mine := [(low, high) for run, low, high in spans if run == i]:
            refuse_rising_energy(trace, model, mine, period)
    poses = None
    if rest:
        poses = rests(traces, sigma, rest)
    elif not released:
        for trace, size in zip(fitted_parts(traces, spans), sigma, strict=True):
            notes += advice_on_rest(trace, size, slowest)
    return Samples(traces, spans, sigma, held, poses, period, tuple(notes))


def with_model_error(traces: list[Trace], scene: Scene) -> tuple[list[Trace], list[str]]:
    """The traces with the model error of the scene's `[fit]`, otherwise their own, which is noted."""
    if scene.fit is not None and scene.fit.model_error:
        return [replace(trace, model_error=scene.fit.model_error) for trace in traces], []
    errors = [f"{trace.model_error:.2g} rad ({trace.name})" for trace in traces if trace.model_error]
    if not errors:
        return traces, []
    return list(traces), [
        f"model error as stated by the traces: {', '.join(errors)}; `model_error` in [fit] replaces it"
    ]
