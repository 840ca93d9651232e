"""`fit`: from traces and a scene to calibrated parameters with honest errors."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.progress import Progress, silent
from fitting.calibration.preparation import prepare
from fitting.calibration.prepared import Prepared
from fitting.calibration.result import FitResult
from fitting.calibration.summary import summarise
from fitting.estimate import gradient as gradient_method
from fitting.estimate.gauss_newton import Solution, fit_windows
from fitting.estimate.refinement import finer_step, refine
from fitting.estimate.shooting import fit_shooting
from fitting.estimate.windows import Windows
from fitting.traces.trace import Trace, convention

METHODS = ("windows", "shooting", "gradient")


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
    say = progress or silent
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
        from fitting.calibration.comparison import compare

        result.comparison = compare(prepared, progress=say)
        result.seconds["run"] = time.perf_counter() - prepared.begun - result.seconds["compile"]
    say(1.0, result.status)
    return result


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
    say = progress or silent
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
    joined, windows = fit_shooting(
        simulator,
        windows,
        solution,
        continuity=continuity,
        huber=huber,
        frozen=frozen,
        finer=lambda windows, solution: finer_step(simulator, windows, solution, huber, frozen),
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
