"""The steps before any estimate: traces and scene are read and checked, windows cut and their starts found."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dropper_jax import load_scene
from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.run.build import SceneLike, build
from fitting.calibration.laws import tested_parameters
from fitting.calibration.prepared import STEPS_PER_PERIOD, Prepared, at_frames, fitted_parts
from fitting.calibration.wrong_files import refuse_rising_energy, refuse_wrong_file
from fitting.estimate.gaps import lyapunov, transitions
from fitting.estimate.marching import choose_stepper
from fitting.estimate.release import release_of
from fitting.estimate.rest import advice_on_rest, held_start, rests
from fitting.estimate.simulator import Simulator
from fitting.estimate.windows import Piece, Windows, cut, fewest_frames, fill, first_starts
from fitting.parameters.of_scene import by_full_path, default_free, free_of_traces, full_names, rig_priors
from fitting.parameters.parameter import Bounds, Priors, StartValues, adjust_parameters, with_effects
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
    columns: Mapping[str, str] | None = None,
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
    read, notes = [as_trace(item, model.line.links, columns) for item in given], []
    for trace in read:
        check_sampling(trace, model)
        check_unit(trace, model, asked.over(trace.convention))
        notes += refuse_wrong_file(trace, model, asked, names)
    converted = [settle_convention(trace, model, asked) for trace in read]
    runs, notes = [trace for trace, _ in converted], notes + [note for _, more in converted for note in more]
    if dt is not None:
        check_step(runs, dt)
    release = release_of(scene, state, names, len(runs), static_start)
    changed = by_full_path(scene, start, bounds, priors)
    parameters = adjust_parameters(free_of_traces(scene, model, names, release), *changed)
    parameters = at_frames(parameters, runs)
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
        stepper = choose_stepper(model, integrator, scene.run.solver)
        simulator = Simulator(model, parameters, stepper, release, more=tested_parameters(model, parameters))
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


def check_step(traces: Sequence[Trace], dt: float) -> None:
    """Reject a requested step that is longer than the sampling interval.

    Between steps angles are interpolated. A step that skips samples is probably a mistyped one: the default is shorter
    than any motion that a camera can follow.
    """
    longest = max(trace.interval for trace in traces)
    if not dt <= longest * (1 + 1e-6):
        raise SceneError(f"dt: {dt:g} s is longer than the sampling interval; allowed: at most {longest:.4g} s")


def check_spans(
    traces: Sequence[Trace], spans: Sequence[tuple[float, float]], option: str = "held-out"
) -> tuple[tuple[float, float], ...]:
    """Sorted spans; messages use the option's name.

    Raises:
        SceneError: a span is empty, overlaps another or lies outside every trace.
    """
    found = sorted((float(low), float(high)) for low, high in spans)
    for i, (low, high) in enumerate(found):
        text = f"{option}: {low:g}:{high:g}"
        if not low < high:
            raise SceneError(f"{text} is empty; allowed: lo < hi")
        if i and low < found[i - 1][1] - 1e-9:
            raise SceneError(f"{text} overlaps {found[i - 1][0]:g}:{found[i - 1][1]:g}. Use separate spans")
        if not any(len(trace.between(low, high).t) > 2 for trace in traces):
            raise SceneError(f"{text} contains no samples; allowed: {traces[0].t[0]:g} to {traces[0].t[-1]:g} s")
    return tuple(found)


def fitted_spans(
    traces: Sequence[Trace], until: float | None, held_out: Sequence[tuple[float, float]]
) -> list[tuple[int, float, float]]:
    """(run, from, to) of all samples that may be fitted: before `until`, outside the held-out spans.

    Raises:
        SceneError: nothing remains.
    """
    found = []
    for i, trace in enumerate(traces):
        low, last = float(trace.t[0]), min(float(trace.t[-1]) + trace.interval, np.inf if until is None else until)
        for begin, end in [*held_out, (last, last)]:
            if low < min(begin, last):
                found.append((i, low, min(begin, last)))
            low = max(low, end)
    if not found:
        raise SceneError("until, held-out: nothing remains to fit. Use spans that leave part of the trace")
    return found


def without_held_starts(
    spans: Sequence[tuple[int, float, float]],
    traces: Sequence[Trace],
    sigma: Sequence[np.ndarray],
    slowest: float,
    pose: Callable[[], np.ndarray],
) -> tuple[list[tuple[int, float, float]], list[str]]:
    """The fitted spans of traces without the still stretch before a release, and a note on each stretch left out.

    Args:
        traces: the samples of every run that may be fitted, the rest missing.
        sigma: noise of each run's links (n,) [rad].
        slowest: period [s] of the line as one pendulum.
        pose: gives the angles (n,) [rad] at rest; only called if a trace starts still.
    """
    found, notes = list(spans), []
    for i, trace in enumerate(traces):
        if (begin := held_start(trace, sigma[i], slowest, pose)) is not None:
            found = [(run, max(low, begin) if run == i else low, high) for run, low, high in found]
            notes.append(
                f"{trace.name} is held still until {begin:.3g} s, in a pose that its own ends do not hold: the fit "
                "starts there"
            )
    return [(run, low, high) for run, low, high in found if low < high], notes


def time_step(traces: Sequence[Trace], requested: float) -> float:
    """The step [s] nearest below `requested` that divides the sampling interval, for uniform sampling.

    Times in files are rounded: a step may exceed `requested` by that rounding.
    """
    intervals = [round(trace.interval, 12) for trace in traces]
    if np.ptp(intervals) > 1e-9:
        return requested
    # relative change of a step that rounded times of samples may cause
    return max(intervals) / max(1, int(np.ceil(max(intervals) / requested - 1e-3)))


# Windows that are as long as the growth of small errors in the motion allows.
#
# Let M_k be the transition of window k, the derivative of its end by its start in units of a gap's scale. Errors grow
# over windows j to k by at most the largest singular value of M_k ... M_j. The largest Lyapunov exponent is the mean
# growth rate of the product of all. A whipping motion grows by far more than this mean at some moments. Windows are
# therefore joined from short ones, up to the length that the growth of their own product allows.

#: Maximum growth of an error over a fit window, in e-folds.
FIT_GROWTH = 2.0
#: Shortest windows that are joined, as a fraction of the shortest link's period: links that whip at ten times the rate
#: of their own swing turn by less than one turn in it.
SHORTEST_PART = 0.2
#: Longest automatic window [s], and as a fraction of the trace.
LONGEST, LONGEST_PART = 10.0, 0.125


def longest_window(freedoms: int, length: float, span: float, shortest: float) -> float:
    """Longest window [s]: one second per 0.1 m link of a chain; long where chaos is impossible."""
    chaotic = float(np.sqrt(length / 0.1)) if freedoms > 1 else np.inf  # one angle cannot be chaotic
    return max(shortest, min(LONGEST, LONGEST_PART * span, chaotic))


def follow_motion(windows: Windows, move: np.ndarray, steps: int) -> list[Piece]:
    """Windows joined from short ones while an error grows by at most `FIT_GROWTH` e-folds over them.

    Args:
        windows: short ones, each ending on a whole frame.
        move: their transitions (K, m2, m2).
        steps: maximum steps of a window.
    """
    found: list[Piece] = []
    one = np.eye(move.shape[1])
    move = np.where(windows.released[:, None, None], one, move)  # the start of a released window comes from the model
    product = one
    for k, matrix in enumerate(move):
        piece, further = windows.piece(k), matrix @ product
        total = piece.steps + sum(last.steps for last in found[-1:])
        grown = np.linalg.norm(further, 2) if np.isfinite(further).all() else np.inf
        if found and piece.follows and total <= steps and grown <= np.exp(FIT_GROWTH):
            found[-1], product = found[-1]._replace(steps=total), further
        else:
            found.append(piece)
            product = matrix
    return found
