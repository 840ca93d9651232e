"""`fit`: from traces and a scene to calibrated parameters with honest errors."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from dropper_jax.base.errors import Progress, SceneError, nearest, silent
from dropper_jax.base.read import ScenePath
from dropper_jax.run.build import SceneLike
from fitting.calibration.advice import Candidate, advise, omitted_parameter_bias
from fitting.calibration.comparison import compare
from fitting.calibration.estimating import FIRST, estimate, with_sound_windows
from fitting.calibration.freeing import MOST_FREED, free_by_advice
from fitting.calibration.kicks import without_kicks
from fitting.calibration.laws import law_warnings, test_laws, with_law
from fitting.calibration.likely_cause import free_too
from fitting.calibration.preparation import TracesLike, prepare
from fitting.calibration.prepared import Prepared
from fitting.calibration.result import FitResult, direction_text, score_held_out
from fitting.calibration.short_windows import SUSPECT, name_wrong_file
from fitting.estimate.gaps import lyapunov
from fitting.estimate.loss import loss_of
from fitting.estimate.problem import CHI2_RANGE, CORRELATION_FLOOR, Solution
from fitting.estimate.scene_fit import Intervals, common_warnings
from fitting.estimate.uncertainty import Uncertainty, degrees_of_freedom, uncertainty
from fitting.parameters.parameter import Bounds, Priors, StartValues
from fitting.traces.trace import convention

# From a solution to a result: errors, held-out scores, and warnings that a user must know before trusting it

#: Standard deviations beyond which a sample is an outlier (one in 2 million of normal noise), and how many are listed.
STANDS_OUT, NAMED_SAMPLES = 5.0, 5

#: Warnings for noise that is not white.
NAMED = {
    "correlated": "the noise is correlated: a sample keeps part of the previous one; weights and errors allow for it",
    "jitter": "frame times have random errors, the same for all links; weights and errors allow for it",
}


def warnings_of(prepared: Prepared, solution: Solution, u: Uncertainty, chi2: float) -> list[str]:
    """One line each: active bounds, parameters that are not identifiable, correlated residuals, failed steps."""
    values = solution.by_name
    names = list(values)
    found = common_warnings(solution, u)
    found += [
        f"not identifiable from the data: direction ({direction_text(direction)}) in relative changes"
        for direction in u.undetermined
    ]
    # absolute correlation of two estimates above which they are reported as hard to distinguish
    close = np.argwhere(np.abs(np.triu(u.correlation, 1)) > 0.98)
    found += [
        f"{names[i]} and {names[j]} are hard to distinguish (correlation {u.correlation[i, j]:.3f})" for i, j in close
    ]
    found += [
        f"{name} is not determined: {values[name]:.3g} with standard error {error:.2g}"
        for name, error, on in zip(names, u.std_error, u.at_bound, strict=True)
        if not on and error > abs(values[name]) and name.startswith("effects.")
    ]
    found += [
        f"left out: {prepared.traces[run].name} {low:.3f} to {high:.3f} s, no start of this window explains its samples"
        for run, low, high in prepared.left_out
    ]
    found += [
        f"the motion of {prepared.traces[run].name} jumps at {time:.3f} s, as after a kick, a contact or lost frames; "
        "windows are not joined there"
        for run, time in prepared.breaks
    ]
    if u.inflation > 1 or abs(u.correlation_1) > 4 * CORRELATION_FLOOR:
        found.append(
            f"residuals are not noise: neighbours correlate by {u.correlation_1:.2f}; standard errors were multiplied "
            f"by up to {u.inflation:.2g}"
        )
    noise = solution.problem.noise
    if noise is not None and noise.kind != "white":
        found.append(NAMED[noise.kind])
    elif chi2 > CHI2_RANGE[1]:
        found.append(
            f"chi-square per degree of freedom is {chi2:.3g}: the noise of the samples does not explain the residuals"
        )
    elif chi2 < CHI2_RANGE[0] and any(trace.se is not None for trace in prepared.traces):
        found.append(f"chi-square per degree of freedom is {chi2:.3g}: the stated standard errors are too large")
    found += outliers(prepared, solution)
    failed = int(solution.evaluation.failed.sum())
    if failed:
        found.append(f"{failed} steps of the final simulation are above the solver's tolerance or have no derivative")
    if solution.status != "ok":
        found.append(f"not converged: {solution.message}; the best point found is reported")
    elif solution.message:
        found.append(f"the cost is non-smooth here: {solution.message}")
    return found


def outliers(prepared: Prepared, solution: Solution) -> list[str]:
    """A line on outlying samples, with run, link and time, if there are any."""
    windows = solution.windows
    size = np.ma.array(np.abs(solution.evaluation.residual), mask=windows.weight == 0)
    # relative to the residuals' own spread, which outliers do not widen
    size = np.ma.filled(size / np.maximum(np.ma.median(size, axis=(0, 1)) / 0.6745, 1e-300), 0.0)
    out = np.argwhere(size > STANDS_OUT)
    if not len(out):
        return []
    largest = out[np.argsort(-size[tuple(out.T)])[:NAMED_SAMPLES]]
    positions = [
        f"{prepared.traces[windows.run[window]].name} link {link} at {windows.times()[window, slot]:.3f} s"
        for window, slot, link in largest
    ]
    more = f" and {len(out) - len(positions)} more" if len(out) > len(positions) else ""
    advice = "" if solution.problem.loss.redescends else ". Use --student to reduce their weight"
    return [
        f"{len(out)} samples stand out by more than {STANDS_OUT:g} standard deviations: "
        f"{', '.join(positions)}{more}{advice}"
    ]


def summarise(prepared: Prepared, method: str, solution: Solution) -> FitResult:
    """The result of a solution: errors, held-out scores, warnings."""
    simulator, windows = prepared.simulator, solution.windows
    rate = lyapunov(simulator, windows, solution.evaluation, solution.values)
    # held-out stretches use the same step size as the fit
    prepared = replace(prepared, windows=replace(prepared.windows, substeps=windows.substeps))
    u = uncertainty(solution)
    expected = prepared.windows.weight
    claimed = float(np.sqrt(np.mean(1 / expected[expected > 0] ** 2)))
    chi2 = float(np.sum(solution.weights * (solution.errors * expected) ** 2)) / degrees_of_freedom(solution)
    scored = prepared.noisy(solution.problem.noise)
    laws = test_laws(prepared, solution, u)
    compiled = simulator.compile_s - prepared.compiled_before
    return FitResult(
        scene=prepared.scene,
        method=method,
        uncertainty=u,
        noise=claimed,
        chi2_per_dof=chi2,
        seconds={"compile": compiled, "run": time.perf_counter() - prepared.started - compiled},
        solution=solution,
        traces=prepared.traces,
        lyapunov=rate,
        laws=laws,
        left_out=prepared.left_out,
        held_out=[score_held_out(scored, solution.values, span) for span in prepared.held_out],
        warnings=[*prepared.warnings, *warnings_of(prepared, solution, u, chi2), *law_warnings(laws)],
    )


def likeliest(prepared: Prepared, result: FitResult, tested: Sequence[Candidate]) -> str:
    """The force or the number of the scene that explains most of a misfit, and what frees it; empty if none does."""
    candidates = [candidate for candidate in tested if candidate.worth_naming][:1]
    candidates += [test for test in result.laws.significant if test.free][:1]
    best = max(candidates, key=lambda candidate: candidate.gain, default=None)
    return "" if best is None else f"{best.name}; {free_too(prepared, best.free)}"


METHODS = ("windows", "shooting", "gradient")


def fit(
    traces: TracesLike,
    scene: SceneLike,
    free: Sequence[str] | None = None,
    *,
    method: str = "shooting",
    start: StartValues | None = None,
    bounds: Bounds | None = None,
    priors: Priors | None = None,
    until: float | None = None,
    held_out: Sequence[tuple[float, float]] = (),
    rest: Sequence[tuple[float, float]] = (),
    window: float | None = None,
    dt: float | None = None,
    zero: str | None = None,
    sign: int | None = None,
    unit: str | None = None,
    columns: Mapping[str, str] | None = None,
    huber: float | None = None,
    student: bool = False,
    robust: str | None = None,
    continuity: str = "estimate",
    iterations: int = 40,
    static_start: bool = False,
    compare_models: bool = False,
    advice: bool = False,
    auto_free: bool = False,
    integrator: str | None = None,
    profile: Sequence[str] | bool = False,
    bootstrap: int = 0,
    progress: Progress | None = None,
    **settings: Any,
) -> FitResult:
    """Calibrate parameters of a scene to measured angles.

    Args:
        traces: CSV files or `Trace`s; several runs of the same line are fitted together.
        scene: packaged name, TOML file, plain values or a `Scene`; its values are the start values.
        free: paths of parameters, or unique last names such as `b_l`; default: those listed in the scene's `[fit]`,
            otherwise its damping.
        method: `windows`, `shooting` (Gauss-Newton), or `gradient`: the minimum of `shooting` by gradient descent.
        start, bounds, priors: by name: start value; (low, high); (mean, standard deviation). Priors from the scene's
            `[fit]` apply to parameters without one here.
        until: samples from this time [s] on are not fitted.
        held_out: (low, high) [s] that are not fitted but scored; only their starts are fitted, afterwards.
        rest: (low, high) [s] in which the line hangs at rest, before it moves or after it has stopped; these poses are
            fitted together with the motion.
        window: length [s]; default from the Lyapunov exponent.
        dt: time step [s], at most the samples' interval; a shorter step that divides the interval is used. Default:
            1/75 of the shortest link's period, or 1/200 for second order.
        integrator: of the windows; default rattle_4 for point masses, otherwise energy_momentum. tsit5 and dop853 are
            faster for lines that they support; `dt` is then their output interval.
        zero, sign, unit: angle convention of the traces; default from the files, otherwise inferred from the scene.
        columns: the files' columns if they have other names: `{"time": "timestamp", "theta_1": "angle"}`.
        huber: threshold of a robust loss in standard deviations, such as 3; default least squares.
        student: Student's t loss with 4 degrees of freedom, started from the end of Huber's; for traces with outliers.
        robust: the same losses by name, `huber` (threshold 3) or `student`.
        continuity: for `shooting`: `estimate`, `tight` or `exact`.
        iterations: maximum Gauss-Newton iterations over separate windows.
        static_start: every run starts from the scene's `[start]` and is released at t = 0 of its clock; free names such
            as `release.time` and `release.force` imply it.
        advice: also test what else may be wrong, by score tests (`advice`).
        auto_free: free the candidate with the largest gain, one at a time, while the fit improves.
        compare_models: also fit the ladder of damping laws.
        profile: names of free parameters whose profile-likelihood intervals are also computed; True for all.
        bootstrap: number of draws of a bootstrap over blocks of time.
        progress: called with (fraction, text).
        **settings: of the gradient method: `optimizer` (`lbfgs`, `adam`, `sgd` or a transformation of optax),
            `learning_rate`, `steps`, `horizon`, `loss`; see `gradient.GradientDescent`.

    Raises:
        SceneError: for any invalid input, in one line.
    """
    if method not in METHODS:
        raise SceneError(f"method: {method!r} is unknown; {nearest(method, METHODS)}")
    if settings and method != "gradient":
        name = min(settings)
        raise SceneError(f"{name}: {settings[name]!r} is not a setting of method {method!r}. Use method gradient")
    if method == "gradient":
        from fitting.estimate.gradient import descent_of  # noqa: PLC0415 - optax is slow to import

        descent_of(settings)  # rejects invalid settings before anything is compiled
    asked = Intervals(profile, bootstrap)
    progress = progress or silent
    started = time.perf_counter()
    prepared = prepare(
        traces,
        scene,
        free,
        start=start,
        bounds=bounds,
        priors=priors,
        until=until,
        held_out=held_out,
        rest=rest,
        window=window,
        dt=dt,
        asked=convention(zero, sign, unit),
        static_start=static_start,
        integrator=integrator,
        columns=columns,
        progress=progress,
    )
    tied = next((p.name for p in prepared.parameters if ScenePath(p.name).section == "parameters"), None)
    if tied and (auto_free or compare_models):  # both change the effects of the model along which it moves
        option = "auto_free" if auto_free else "compare_models"
        raise SceneError(f"{option}: not with {tied!r} free. Omit it, or free paths of the scene such as b_l")
    asked.profile_names(prepared.scene, prepared.parameters)  # rejects unknown names before anything is fitted
    loss = loss_of(huber, student, robust)
    sound = with_sound_windows(prepared, loss, iterations, progress, keep_jumps=auto_free)
    if method == "gradient" and not auto_free:  # the descent is separate: it only takes the windows of the other fit
        sound = replace(sound, begin=prepared.begin, starts=sound.starts_from_samples())
    whole, prepared = prepared, sound
    again = partial(estimate, continuity=continuity, iterations=iterations, progress=progress)
    found, freed = [], []
    if auto_free:
        if sound.left_out or sound.windows.count > whole.windows.count:  # some windows were lost
            whole, freed = without_kicks(whole, again, loss)
        if freed:
            prepared = with_sound_windows(whole, loss, iterations, progress, keep_jumps=True)
        at = free_by_advice(prepared, again, "shooting" if method == "gradient" else method, loss, progress=progress)
        prepared, solution, found, freed = at.prepared, at.solution, at.found, [*freed, *at.names]
        loss = at.loss
        if method == "gradient":
            solution = again(prepared, method, at.loss, settings=settings)
    else:
        left = iterations if method == "gradient" else max(iterations - sound.iterations, min(iterations - 1, FIRST), 1)
        solution = again(prepared, method, loss, iterations=left, settings=settings)
        if advice and solution.status == "ok":
            found = advise(prepared, solution)
    known = replace(prepared.known, doubt=omitted_parameter_bias(freed, prepared.parameters))
    solution.problem = replace(solution.problem, known=known)
    solution.iterations += prepared.iterations
    prepared = replace(prepared, started=started, known=known)
    result = summarise(prepared, method, solution)
    while auto_free and result.status == "model_error" and result.laws.wrong.free and len(freed) < MOST_FREED:
        freed = [*freed, result.laws.wrong]
        prepared = with_law(prepared, result.laws.wrong.free, solution)
        solution = again(prepared, method, loss, settings=settings)
        result = summarise(prepared, method, solution)
    if result.status != "ok" or result.chi2_per_dof > SUSPECT:
        result.wrong_file = name_wrong_file(whole)
    if result.status == "misfit" and not (result.wrong_file or auto_free or method == "gradient"):
        result.likely = likeliest(prepared, result, found or advise(prepared, solution))
    result.advice, result.freed = found, freed
    # number of candidates listed in the warnings
    result.warnings += [str(candidate) for candidate in found if candidate.worth_naming][:3]
    asked.add_to(result, progress)
    if compare_models:
        result.comparison = compare(prepared.noisy(solution.problem.noise), progress=progress)
        result.seconds["run"] = time.perf_counter() - started - result.seconds["compile"]
    progress(1.0, result.status)
    return result
