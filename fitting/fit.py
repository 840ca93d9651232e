"""`fit`: from traces and a scene to calibrated parameters with honest errors."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax import build, load_scene
from dropper_jax.errors import SceneError, nearest
from fitting import gradient as gradient_method
from fitting import lyapunov as chaos
from fitting.conventions import settle_convention
from fitting.gauss_newton import Solution, fit_windows
from fitting.heldout import check_spans, fitted_spans, only
from fitting.naming import default_free, full_names
from fitting.parameters import Parameter, missing_effects, resolve
from fitting.planar import check_planar
from fitting.refinement import refine
from fitting.release import release_of
from fitting.result import FitResult
from fitting.shooting import fit_shooting
from fitting.simulator import Simulator, choose_stepper
from fitting.summary import summarise
from fitting.traces import Convention, Trace, convention, noise, read_trace
from fitting.windows import Starts, Windows, check_step, cut, first_starts, time_step

METHODS = ("windows", "shooting", "gradient")
#: Steps per period of the shortest link as a pendulum, by the scheme's order: 1/120 s for the lab dropper (error after
#: 1 s 1.6e-5 rad) at order 4; second order takes four times as many.
STEPS_PER_PERIOD = {4: 75, 2: 300}
#: Half width [s] of the smoother for the starts, as a part of that period.
SMOOTH_PART = 0.12

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Prepared:
    """Everything an estimator needs: what `prepare` made of the caller's input."""

    scene: Any
    traces: list[Trace]
    sigma: list[np.ndarray]
    parameters: tuple[Parameter, ...]
    simulator: Simulator
    windows: Windows
    starts: Starts
    held_out: tuple[tuple[float, float], ...]
    lyapunov: float
    period: float
    warnings: tuple[str, ...]
    begun: float = 0.0
    compiled_before: float = 0.0

    @property
    def values(self) -> np.ndarray:
        """Start values (k,)."""
        return np.array([p.value for p in self.parameters])


def fit(
    traces: Sequence[str | Path | Trace] | str | Path | Trace,
    scene: Any,
    free: Sequence[str] | None = None,
    *,
    method: str = "shooting",
    start: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    until: float | None = None,
    held_out: Sequence[tuple[float, float]] = (),
    window: float | None = None,
    dt: float | None = None,
    zero: str | None = None,
    sign: int | None = None,
    unit: str | None = None,
    huber: float | None = None,
    continuity: str = "estimate",
    iterations: int = 40,
    static_start: bool = False,
    compare_models: bool = False,
    progress: Progress | None = None,
    **settings: Any,
) -> FitResult:
    """Calibrate parameters of a scene to measured angles.

    Args:
        traces: CSV files or `Trace`s; several runs of the same line are fitted together.
        scene: packaged name, TOML file, plain values or a `Scene`; its values are the start values.
        free: paths of parameters, or unique last names such as `b_l`; default: the scene's damping.
        method: `windows`, `shooting` or `gradient`; see their modules.
        start, bounds, priors: by path: start value; (low, high); (mean, standard deviation).
        until: samples from this time [s] on are not fitted.
        held_out: (low, high) [s] that are not fitted but scored; only their starts are fitted, afterwards.
        window: length [s]; default from the Lyapunov exponent.
        dt: time step [s], at most the samples' interval; a shorter one that divides it is taken. Default: 1/75 of the
            shortest link's period, or 1/300 for second order.
        zero, sign, unit: how the traces count angles; default as the files say, else guessed from the scene.
        huber: threshold of a robust loss in standard deviations, such as 3; default least squares.
        continuity: for `shooting`: `estimate`, `tight` or `exact`.
        iterations: most Gauss-Newton iterations over separate windows.
        static_start: every run begins as the scene's `[start]` says, let go at t = 0 of its clock; free names such as
            `release.time` and `release.force` imply it.
        compare_models: also fit the ladder of damping laws.
        progress: called with (fraction, text).
        **settings: of the gradient method: see `gradient.fit_gradient`.

    Raises:
        SceneError: for anything the caller can mend, in one line.
    """
    if method not in METHODS:
        raise SceneError(f"method: {method!r} is unknown; {nearest(method, METHODS)}")
    if settings and method != "gradient":
        raise SceneError(f"method: {method!r} has no setting {sorted(settings)[0]!r}; allowed: none")
    say = progress or (lambda fraction, text: None)
    asked = convention(zero, sign, unit)
    prepared = prepare(
        traces,
        scene,
        free,
        start=start,
        bounds=bounds,
        priors=priors,
        until=until,
        held_out=held_out,
        window=window,
        dt=dt,
        asked=asked,
        static_start=static_start,
        progress=say,
    )
    solution, windows = estimate(prepared, method, huber, continuity, iterations, say, settings)
    result = summarise(prepared, method, solution, windows)
    if compare_models:
        from fitting.comparison import compare

        result.comparison = compare(prepared, progress=say)
        result.seconds["run"] = time.perf_counter() - prepared.begun - result.seconds["compile"]
    say(1.0, result.status)
    return result


def prepare(
    traces: Any,
    scene: Any,
    free: Sequence[str] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    bounds: Mapping | None = None,
    priors: Mapping | None = None,
    until: float | None = None,
    held_out: Sequence[tuple[float, float]] = (),
    window: float | None = None,
    dt: float | None = None,
    asked: Convention = Convention(),  # noqa: B008 - frozen
    static_start: bool = False,
    simulator: Simulator | None = None,
    progress: Progress | None = None,
) -> Prepared:
    """Read and check everything, cut windows, find their starts.

    Arguments as in `fit`; `simulator` is that of an earlier call on the same scene and parameters, compiled already.
    """
    say = progress or (lambda fraction, text: None)
    say(0.0, "reading")
    begun, compiled_before = time.perf_counter(), 0.0 if simulator is None else simulator.compile_s
    scene = load_scene(scene)
    names = default_free(scene) if free is None else full_names(scene, free)
    added = missing_effects(scene, names)
    scene = scene.with_values(added) if added else scene
    model, state = build(scene)
    check_planar(model, state)
    read = [settle_convention(trace, model, asked) for trace in _as_traces(traces, model.line.links)]
    runs, notes = [trace for trace, _ in read], [note for _, more in read for note in more]
    if dt is not None:
        check_step(runs, dt)
    release = release_of(scene, state, names, len(runs), static_start)
    parameters = resolve(model, names, start, bounds, priors, release=release)
    held_out = check_spans(runs, held_out)
    spans = fitted_spans(runs, until, held_out)
    span = max(high - low for _, low, high in spans)
    period = 2 * np.pi * np.sqrt(float(np.min(model.line.length)) / 9.81)
    simulator = simulator or Simulator(model, parameters, choose_stepper(model), release)
    simulator.parameters = parameters
    dt = time_step(runs, dt or period / STEPS_PER_PERIOD[simulator.stepper.integrator.order])
    # what is held out touches nothing, not even the noise or the first guess of a start
    seen = [only(trace, [(low, high) for run, low, high in spans if run == i]) for i, trace in enumerate(runs)]
    sigma = [noise(trace) for trace in seen]
    length = window or chaos.first_window(simulator.freedoms // 2, float(np.mean(model.line.length)), span)
    values = np.array([p.value for p in parameters])

    def windowed(length: float) -> tuple[Windows, Starts, float]:
        say(0.02, f"windows of {length:.3g} s: compiling")
        windows = cut(runs, length, dt, sigma, spans)
        if release is not None:
            windows = release.mark(windows, runs)
            simulator.parameters = release.bounded(simulator.parameters, windows)
        starts = first_starts(model, seen, windows, SMOOTH_PART * period)
        evaluation = simulator(values, starts, windows)
        _check_effective(parameters, evaluation.jacobian, simulator.freedoms)
        return windows, starts, chaos.lyapunov(simulator, windows, evaluation, values)

    windows, starts, rate = windowed(length)
    shorter = chaos.shorter_window(length, rate)
    if window is None and shorter < length:
        windows, starts, rate = windowed(shorter)
    if release is not None:
        values = release.guess(simulator, windows, starts, values)
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
        begun=begun,
        compiled_before=compiled_before,
    )


def _as_traces(traces: Any, links: int) -> list[Trace]:
    items = [traces] if isinstance(traces, str | Path | Trace) else list(traces)
    if not items:
        raise SceneError("traces: none given; allowed: one or more CSV files")
    found = [item if isinstance(item, Trace) else read_trace(item, links) for item in items]
    for trace in found:
        if trace.links != links:
            raise SceneError(
                f"{trace.name}: has {trace.links} angles, but the scene has {links} links; allowed: {links}"
            )
    return found


def _check_effective(parameters: Sequence[Parameter], jacobian: np.ndarray, freedoms: int) -> None:
    """Refuse a parameter that changes no residual."""
    size = np.abs(jacobian[..., freedoms:]).max(axis=(0, 1, 2), initial=0.0)
    for p, found in zip(parameters, size, strict=True):
        if found == 0.0:
            raise SceneError(f"free: {p.name!r} does nothing to the traced angles; allowed: a parameter that does")


def estimate(
    prepared: Prepared,
    method: str = "shooting",
    huber: float | None = None,
    continuity: str = "estimate",
    iterations: int = 40,
    progress: Progress | None = None,
    settings: Mapping[str, Any] | None = None,
    frozen: np.ndarray | None = None,
) -> tuple[Solution, Windows]:
    """Run an estimator; returns its solution and the windows with the noise it used; arguments as in `fit`."""
    say = progress or (lambda fraction, text: None)
    simulator, windows = prepared.simulator, prepared.windows
    if method == "gradient":
        solution = gradient_method.fit_gradient(
            simulator, windows, prepared.values, prepared.starts, progress=say, **(settings or {})
        )
        return solution, windows
    share = 0.5 if method == "shooting" else 0.9
    solution = fit_windows(
        simulator,
        windows,
        prepared.values,
        prepared.starts,
        huber=huber,
        iterations=iterations,
        frozen=frozen,
        progress=lambda fraction, text: say(0.05 + share * fraction, text),
    )
    if solution.status != "ok":
        return solution, windows
    fine = partial(refine, simulator, huber=huber, frozen=frozen, progress=lambda _, text: say(0.95, text))
    if method == "windows":
        return fine(windows, solution)
    windows, solution = renoise(windows, solution, simulator.freedoms)
    joined = fit_shooting(
        simulator,
        windows,
        solution,
        continuity=continuity,
        huber=huber,
        frozen=frozen,
        progress=lambda fraction, text: say(0.55 + 0.4 * fraction, text),
    )
    return fine(windows, joined) if joined.status == "ok" else (joined, windows)


def renoise(windows: Windows, solution: Solution, freedoms: int) -> tuple[Windows, Solution]:
    """Windows whose noise is the fit's own residual deviation, and the solution in these units."""
    dof = max(1, windows.samples - windows.free_starts * freedoms - len(solution.values))
    factor = float(np.sqrt(solution.chi2 / dof))
    if factor <= 0:
        return windows, solution
    e = solution.evaluation
    e = e._replace(residual=e.residual / factor, jacobian=e.jacobian / factor)
    scaled = replace(
        solution,
        evaluation=e,
        cost=solution.cost / factor**2,
        information=solution.information / factor**2,
        gradient=solution.gradient / factor**2,
    )
    return replace(windows, weight=windows.weight / factor), scaled
