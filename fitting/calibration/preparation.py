"""The stages before any estimate: traces are read and checked, samples chosen, windows cut and their starts found."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from dropper_jax import load_scene
from dropper_jax.base.errors import Progress, SceneError, nearest, silent
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.run.build import SceneLike, build
from fitting.calibration.prepared import STEPS_PER_PERIOD, Prepared, Samples, fitted_parts, program_space
from fitting.calibration.spans import (
    Interval,
    advice_on_rest,
    check_spans,
    check_step,
    fitted_spans,
    time_step,
    without_held_starts,
)
from fitting.calibration.wrong_files import refuse_rising_energy, refuse_wrong_file
from fitting.estimate.normal_equations import Evaluation
from fitting.estimate.release import Release, release_of
from fitting.estimate.rest import rests
from fitting.estimate.shooting import lyapunov, transitions
from fitting.estimate.simulator import Simulator, choose_stepper
from fitting.estimate.windows import (
    SHORTEST_WINDOW_PERIODS,
    Starts,
    Windows,
    cut,
    fewest_frames,
    fill,
    first_starts,
    follow_motion,
    longest_window,
)
from fitting.parameters.missing_forces import tested_parameters
from fitting.parameters.names import by_full_path, default_free, default_rig, full_names
from fitting.parameters.of_scene import free_of_traces
from fitting.parameters.parameter import Bounds, Parameter, Priors, StartValues, adjust_parameters, with_zero_damping
from fitting.parameters.recordings import SharedMotion, convention_distance, merge_recordings, stated_errors
from fitting.parameters.rig_priors import rig_priors
from fitting.parameters.targets import RECORDING, LostTarget
from fitting.traces.conventions import check_scale, settle_convention
from fitting.traces.noise import noise
from fitting.traces.planar import check_planar, pendulum_period
from fitting.traces.trace import Convention, Trace, as_trace, convention

#: Maximum turn of a link in a step [rad] at the start of a fit, and the fraction of windows that it applies to. The
#: error of a fourth-order scheme over a window is then below the usual noise; otherwise `refine` halves the step.
TURN_PER_STEP = 0.25
TURN_QUANTILE = 0.98

#: One run or several: CSV files or traces.
TracesLike = Sequence[str | Path | Trace] | str | Path | Trace


@dataclass(frozen=True)
class FitSettings:
    """How a fit reads traces and cuts them into windows.

    Attributes:
        window: maximum length of a window [s]; None: as far as small errors in the motion may grow.
        dt: time step [s], at most the samples' interval; a shorter step that divides the interval is used. Default:
            1/75 of the shortest link's period, or 1/200 for second order.
        integrator: of the windows; default rattle_4 for point masses, otherwise energy_momentum. tsit5 and dop853 are
            faster for lines that they support; their steps then end at multiples of `dt`.
        rest: (low, high) [s] in which the line hangs at rest, before it moves or after it has stopped; these poses are
            fitted together with the motion.
        static_start: every run starts from the scene's `[start]` and is released at t = 0 of its clock; free names such
            as `release.time` and `release.force` imply it.
        zero, sign, unit: angle convention of the traces; default from the files, otherwise inferred from the scene.
        columns: the files' columns if they have other names: `{"time": "timestamp", "theta_1": "angle"}`.
        begin: samples before this time [s] are not fitted.
        fixed: whether the scene's lengths and the zero of the angles are kept where neither the caller nor the scene's
            `[fit]` lists what is free; otherwise a scale of the lengths and the zero are free too.
        same_motion: whether the traces are recordings of one motion (`parameters.recordings`), not runs. All but the
            first one have zeros, a scale and a delay, free unless the caller frees some of them by name.
    """

    window: float | None = None
    dt: float | None = None
    integrator: str | None = None
    rest: Sequence[Interval] = ()
    static_start: bool = False
    zero: str | None = None
    sign: str | int | None = None
    unit: str | None = None
    columns: Mapping[str, str] | None = None
    begin: float | None = None
    fixed: bool = False
    same_motion: bool = False

    @property
    def convention(self) -> Convention:
        """The given convention of the angles, checked."""
        return convention(self.zero, self.sign, self.unit)


#: No settings: everything from the traces and the scene.
AUTOMATIC = FitSettings()


@dataclass(frozen=True)
class WindowPlan:
    """Sizes of the windows: time step [s], maximum length [s], steps of the short ones that are joined."""

    dt: float
    length: float
    short: int


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
        motion = _same_motion(read, start, settings, release)
        notes += motion.notes
        read = [motion.trace]
        parameters = (*parameters, *some_of(motion.parameters, of_recordings))
        for p in motion.parameters:  # a given delay is where the search for it starts
            if p.name.endswith(".delay") and p.name in changed.start:
                changed.start[p.name] = p.value
    elif of_recordings:
        raise SceneError(f"free: {of_recordings[0]!r}: only for recordings of one motion. Use --same-motion")
    parameters = adjust_parameters(parameters, *changed)
    parameters, known = rig_priors(scene, model, at_frames(parameters, read))
    samples = choose_samples(read, scene, model, until, held_out, settings, release is not None)
    if simulator is None:
        stepper = choose_stepper(model, settings.integrator, scene.run.solver)
        simulator = Simulator(model, parameters, stepper, release, more=tested_parameters(model, parameters))
    else:
        simulator = simulator.view_of(parameters)
    plan = plan_windows(samples, simulator, settings)
    simulator.capacity = program_capacity(samples, plan)
    progress(0.02, f"windows of at most {plan.length:.3g} s: compiling")
    values = np.array([p.value for p in parameters])
    windows, starts, growth = windows_along_motion(samples, simulator, release, plan, values)
    _check_effective(simulator, simulator(values, starts, windows))
    if release is not None:
        values = release.guess(lambda *at: simulator(*at).residual, simulator.parameters, windows, starts, values)
        parameters = tuple(replace(p, value=float(v)) for p, v in zip(simulator.parameters, values, strict=True))
    samples = replace(samples, warnings=(*notes, *samples.warnings))
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
    traces: list[Trace], start: StartValues | None, settings: FitSettings, release: Release | None
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


def some_of(parameters: Sequence[Parameter], names: Sequence[str]) -> tuple[Parameter, ...]:
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
    traces = [replace(trace, se=stated_errors(trace)) for trace in traces]
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


def plan_windows(samples: Samples, simulator: Simulator, settings: FitSettings) -> WindowPlan:
    """Time step and length of the windows.

    Raises:
        SceneError: a requested window longer than the trace.
    """
    period = samples.period
    interval = samples.interval
    span = max(one.high - one.low for one in samples.spans)
    dt = time_step(samples.traces, settings.dt or period / STEPS_PER_PERIOD[simulator.stepper.integrator.order])
    fewest = fewest_frames(simulator.model.line.links, simulator.freedoms)
    short = max(SHORTEST_WINDOW_PERIODS * period, fewest * interval)
    link = float(np.mean(np.asarray(simulator.model.line.length)))
    length = settings.window or longest_window(simulator.freedoms // 2, link, span, short)
    if settings.window is not None and settings.window > span:
        raise SceneError(f"window: {settings.window:g} s is longer than the trace; allowed: at most {span:g} s")
    frame = max(1, round(interval / dt))
    frames = max(1, int(length / dt / frame + 1e-6))
    parts = max(1, int(length / short + 1e-6))
    return WindowPlan(dt, length, max(1, frames // parts) * frame)


#: Maximum length of held-out spans, in windows, that run in the windows' own program, compiled with space for them.
LONGEST_HELD_OUT = 2.5


def program_capacity(samples: Samples, plan: WindowPlan) -> tuple[int, int]:
    """Steps and sample slots of the windows' programs."""
    end = max(float(trace.t[-1]) for trace in samples.traces)
    length = max((min(high, end) - low for low, high in samples.held_out), default=0.0)
    if not plan.length < length < LONGEST_HELD_OUT * plan.length:
        length = plan.length
    return program_space(samples.traces, length, plan.dt)


def windows_along_motion(
    samples: Samples, simulator: Simulator, release: Release | None, plan: WindowPlan, values: np.ndarray
) -> tuple[Windows, Starts, float]:
    """Windows as long as the motion allows: short ones are run first and joined (`follow_motion`).

    Returns:
        The windows, the starts that their samples give, and the growth rate of small errors in the motion [1/s].
    """
    model = simulator.model
    sigma = samples.sigma
    fitted = samples.fitted
    windows = cut(samples.traces, plan.short * plan.dt, plan.dt, sigma, samples.spans)
    if release is not None:
        windows = release.mark(windows, samples.traces)
    starts = first_starts(model, fitted, windows, sigma)
    # subdivisions of a step in which the fastest link of nearly all windows turns by at most `TURN_PER_STEP`
    fastest = float(np.quantile(np.abs(starts.omega).max(axis=1), TURN_QUANTILE))
    halvings = max(0, int(np.ceil(np.log2(max(plan.dt * fastest / TURN_PER_STEP, 1e-9)))))
    windows = replace(windows, substeps=2**halvings)
    evaluation = simulator(values, starts, windows)
    rate = lyapunov(simulator, windows, evaluation, values)
    move = transitions(simulator, evaluation, values)
    pieces = follow_motion(windows, move, int(plan.length / plan.dt + 1e-6))
    windows = replace(fill(samples.traces, pieces, plan.dt, sigma), substeps=windows.substeps)
    if release is not None:
        windows = release.mark(windows, samples.traces)
        simulator.parameters = release.bound_times(simulator.parameters, windows)
    return windows, first_starts(model, fitted, windows, sigma), rate
