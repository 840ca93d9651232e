"""The steps before any estimate: traces and scene are read and checked, windows cut and their starts found."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dropper_jax import load_scene
from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.run.build import SceneLike, build
from fitting.calibration.prepared import (
    STEPS_PER_PERIOD,
    Prepared,
    at_frames,
    check_spans,
    fitted_parts,
    fitted_spans,
    without_held_starts,
)
from fitting.calibration.wrong_files import refuse_rising_energy, refuse_wrong_file
from fitting.estimate.gaps import SHORTEST_PART, follow_motion, longest_window, lyapunov, transitions
from fitting.estimate.marching import choose_stepper
from fitting.estimate.release import release_of
from fitting.estimate.rest import advice_on_rest, rests
from fitting.estimate.simulator import Simulator
from fitting.estimate.windows import check_step, cut, fewest_frames, fill, first_starts, time_step
from fitting.parameters.of_scene import default_free, full_names, rig_priors
from fitting.parameters.parameter import Bounds, Priors, StartValues, resolve, with_effects
from fitting.traces.conventions import check_sampling, check_unit, resting_angles, settle_convention
from fitting.traces.planar import check_planar
from fitting.traces.trace import Convention, Trace, as_trace, noise

#: Maximum turn of a link in a step [rad] at the start of a fit, and the fraction of windows that it applies to. The
#: error of a fourth-order scheme over a window is then below the usual noise; otherwise `refine` halves the step.
TURN, FASTEST = 0.25, 0.98

#: One run or several: CSV files or traces.
TracesLike = Sequence[str | Path | Trace] | str | Path | Trace


def prepare(
    traces: TracesLike,
    scene: SceneLike,
    free: Sequence[str] | None = None,
    *,
    start: StartValues | None = None,
    bounds: Bounds | None = None,
    priors: Priors | None = None,
    until: float | None = None,
    held_out: Sequence[tuple[float, float]] = (),
    rest: Sequence[tuple[float, float]] = (),
    window: float | None = None,
    dt: float | None = None,
    asked: Convention = Convention(),  # noqa: B008 - frozen
    static_start: bool = False,
    simulator: Simulator | None = None,
    integrator: str | None = None,
    progress: Progress | None = None,
) -> Prepared:
    """Read and check everything, cut windows, find their starts.

    Arguments as in `fit`; `simulator` is an already compiled one from an earlier call with the same scene and
    parameters.
    """
    say = progress or silent
    say(0.0, "reading")
    started, compiled_before = time.perf_counter(), 0.0 if simulator is None else simulator.compile_s
    scene = load_scene(scene)
    names = default_free(scene) if free is None else full_names(scene, free)
    scene = with_effects(scene, names)
    model, state = build(scene)
    check_planar(model, state)
    given = [traces] if isinstance(traces, str | Path | Trace) else list(traces)
    if not given:
        raise SceneError("traces: none given. Use one or more CSV files")
    read, notes = [as_trace(item, model.line.links) for item in given], []
    for trace in read:
        check_sampling(trace, model)
        check_unit(trace, model, asked.over(trace.convention))
        notes += refuse_wrong_file(trace, model, asked, names)
    converted = [settle_convention(trace, model, asked) for trace in read]
    runs, notes = [trace for trace, _ in converted], notes + [note for _, more in converted for note in more]
    if dt is not None:
        check_step(runs, dt)
    release = release_of(scene, state, names, len(runs), static_start)
    by_path = [
        {full_names(scene, [name], which)[0]: value for name, value in (given or {}).items()}
        for which, given in (("start", start), ("bounds", bounds), ("prior", priors))
    ]
    parameters = at_frames(resolve(model, names, *by_path, release=release), runs)
    parameters, known = rig_priors(scene, model, parameters)
    held_out = check_spans(runs, held_out)
    rest = check_spans(runs, rest, "rest")
    spans = fitted_spans(runs, until, sorted([*held_out, *rest]))
    if scene.fit is not None and scene.fit.model_error:
        runs = [replace(trace, model_error=scene.fit.model_error) for trace in runs]
    elif errors := [f"{trace.model_error:.2g} rad ({trace.name})" for trace in runs if trace.model_error]:
        notes.append(f"model error as stated by the traces: {', '.join(errors)}; `model_error` in [fit] replaces it")
    sigma = [np.hypot(noise(trace), trace.model_error) for trace in fitted_parts(runs, spans)]
    runs = [trace if trace.se is None else replace(trace, se=np.hypot(trace.se, trace.model_error)) for trace in runs]
    slowest = 2 * np.pi * np.sqrt(float(np.sum(np.asarray(model.line.length))) / 9.81)
    if release is None:
        spans, more = without_held_starts(
            spans, fitted_parts(runs, spans), sigma, slowest, lambda: resting_angles(model)
        )
        notes += more
    span = max(high - low for _, low, high in spans)
    period = 2 * np.pi * np.sqrt(float(np.min(np.asarray(model.line.length))) / 9.81)
    for i, trace in enumerate(runs):
        if mine := [(low, high) for run, low, high in spans if run == i]:
            refuse_rising_energy(trace, model, mine, period)
    if simulator is None:
        simulator = Simulator(model, parameters, choose_stepper(model, integrator, scene.run.solver), release)
    elif [p.name for p in simulator.compiled] == [p.name for p in parameters]:
        simulator.parameters = simulator.compiled = parameters
    else:
        simulator = simulator.view_of(parameters)
    dt = time_step(runs, dt or period / STEPS_PER_PERIOD[simulator.stepper.integrator.order])
    # held-out samples affect nothing, not even the noise or the first guess of a start
    seen = fitted_parts(runs, spans)
    poses = rests(runs, sigma, rest)
    if not rest and release is None:
        notes += [line for pair in zip(seen, sigma, strict=True) for line in advice_on_rest(*pair, slowest)]
    interval = max(trace.interval for trace in runs)
    fewest = fewest_frames(model.line.links, simulator.freedoms)
    base = max(SHORTEST_PART * period, fewest * interval)
    length = window or longest_window(
        simulator.freedoms // 2, float(np.mean(np.asarray(model.line.length))), span, base
    )
    if window is not None and window > span:
        raise SceneError(f"window: {window:g} s is longer than the trace; allowed: at most {span:g} s")
    frame = max(1, round(interval / dt))
    frames = max(1, int(length / dt / frame + 1e-6))
    base = max(1, frames // max(1, int(length / base + 1e-6))) * frame
    values = np.array([p.value for p in parameters])
    longest = max((min(high, float(trace.t[-1])) - low for low, high in held_out for trace in runs), default=0.0)
    # maximum length of held-out spans, in windows, that run in the windows' own program, compiled with space for them
    longest_run = longest if length < longest < 2.5 * length else length
    simulator.capacity = int(longest_run / dt + 1e-6), int(longest_run / min(trace.interval for trace in runs) + 1.5)
    say(0.02, f"windows of at most {length:.3g} s: compiling")
    windows = cut(runs, base * dt, dt, sigma, spans)
    if release is not None:
        windows = release.mark(windows, runs)
    starts = first_starts(model, seen, windows, sigma)
    # subdivisions of a step in which the fastest link of nearly all windows turns by at most `TURN`
    fastest = float(np.quantile(np.abs(starts.omega).max(axis=1), FASTEST))
    windows = replace(windows, substeps=2 ** max(0, int(np.ceil(np.log2(max(dt * fastest / TURN, 1e-9))))))
    evaluation = simulator(values, starts, windows)
    rate = lyapunov(simulator, windows, evaluation, values)
    move = transitions(simulator, windows, evaluation, values)
    longer = fill(runs, follow_motion(windows, move, int(length / dt + 1e-6)), dt, sigma)
    windows = replace(longer, substeps=windows.substeps)
    if release is not None:
        windows = release.mark(windows, runs)
        simulator.parameters = release.bound_times(simulator.parameters, windows)
    starts = first_starts(model, seen, windows, sigma)
    slopes = simulator(values, starts, windows).jacobian[..., simulator.freedoms :]
    for p, effective in zip(parameters, slopes.any(axis=(0, 1, 2)), strict=True):
        if not effective:
            raise SceneError(f"free: {p.name!r} does not affect the traced angles. Use a parameter that does")
    if release is not None:
        residuals = lambda *at: simulator(*at).residual  # noqa: E731
        values = release.guess(residuals, simulator.parameters, windows, starts, values)
        parameters = tuple(replace(p, value=float(v)) for p, v in zip(simulator.parameters, values, strict=True))
    return Prepared(
        scene=scene,
        traces=runs,
        sigma=sigma,
        parameters=parameters,
        simulator=simulator,
        windows=windows,
        starts=starts,
        held_out=held_out,
        lyapunov=rate,
        period=period,
        warnings=tuple(notes),
        started=started,
        compiled_before=compiled_before,
        known=known,
        rest=poses,
    )
