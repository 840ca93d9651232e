"""`fit`: from traces and a scene to calibrated parameters with honest errors."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.run.build import SceneLike
from fitting.calibration.advice import advise
from fitting.calibration.candidate import Candidate, omitted_parameter_bias
from fitting.calibration.comparison import refuse_tied
from fitting.calibration.disagreement import disagreement_warnings, disagreements
from fitting.calibration.estimating import FIRST, Method, as_method, estimate, with_sound_windows
from fitting.calibration.freeing import MOST_FREED, free_by_advice
from fitting.calibration.kicks import without_kicks
from fitting.calibration.laws import QUADRATIC, LawTest, law_warnings, test_laws, with_law
from fitting.calibration.likely_cause import free_too
from fitting.calibration.preparation import AUTOMATIC, FitSettings, Prepared, TracesLike, prepare
from fitting.calibration.result import FitResult, direction_text, score_held_out
from fitting.calibration.short_windows import SUSPECT, name_wrong_file
from fitting.estimate.loss import LEAST_SQUARES, Loss, as_loss
from fitting.estimate.residuals import CHI2_RANGE, CORRELATION_FLOOR, Solution
from fitting.estimate.scene_fit import common_warnings
from fitting.estimate.shooting import lyapunov
from fitting.estimate.uncertainty import Uncertainty, degrees_of_freedom, uncertainty
from fitting.parameters.parameter import Bounds, Priors, StartValues

if TYPE_CHECKING:
    from fitting.estimate.descent import GradientDescent

# From a solution to a result: errors, held-out scores, and warnings that a user must know before trusting it

#: Standard deviations beyond which a sample is an outlier (one in 2 million of normal noise), and how many are listed.
STANDS_OUT = 5.0
NAMED_SAMPLES = 5

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
        f"{prepared.traces[windows.run[window]].column_name(column)} at {windows.times()[window, slot]:.3f} s"
        for window, slot, column in largest
    ]
    if len(out) > len(positions):
        more = f" and {len(out) - len(positions)} more"
    else:
        more = ""
    if solution.problem.loss.redescends:
        advice = ""
    else:
        advice = ". Use --student to reduce their weight"
    return [
        f"{len(out)} samples stand out by more than {STANDS_OUT:g} standard deviations: "
        f"{', '.join(positions)}{more}{advice}"
    ]


def summarise(prepared: Prepared, method: str, solution: Solution) -> FitResult:
    """The result of a solution: errors, held-out scores, warnings."""
    simulator = prepared.simulator
    windows = solution.windows
    rate = lyapunov(simulator, windows, solution.evaluation, solution.values)
    u = uncertainty(solution)
    expected = prepared.windows.weight
    claimed = float(np.sqrt(np.mean(1 / expected[expected > 0] ** 2)))
    chi2 = float(np.sum(solution.weights * (solution.errors * expected) ** 2)) / degrees_of_freedom(solution)
    # held-out stretches use the same step size as the fit
    finer = replace(prepared, windows=replace(prepared.windows, substeps=windows.substeps))
    scored = finer.noisy(solution.problem.noise)
    laws = test_laws(prepared, solution, u)
    rows = disagreements(prepared, solution)
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
        recordings=rows,
        prepared=prepared,
        left_out=prepared.left_out,
        held_out=[score_held_out(scored, solution.values, span) for span in prepared.held_out],
        warnings=[
            *prepared.warnings,
            *warnings_of(prepared, solution, u, chi2),
            *law_warnings(laws),
            *disagreement_warnings(rows),
        ],
    )


def fit(
    traces: TracesLike,
    scene: SceneLike,
    free: Sequence[str] | None = None,
    *,
    method: Method | GradientDescent | str = "shooting",
    loss: Loss | str = LEAST_SQUARES,
    start: StartValues | None = None,
    bounds: Bounds | None = None,
    priors: Priors | None = None,
    until: float | None = None,
    held_out: Sequence[tuple[float, float]] = (),
    settings: FitSettings = AUTOMATIC,
    progress: Progress | None = None,
) -> FitResult:
    """Calibrate parameters of a scene to measured angles.

    `advise`, `compare`, `profile`, `bootstrap` and `predict` judge the result; `fit_and_free` also frees what the
    traces show to be wrong.

    Args:
        traces: CSV files or `Trace`s; several runs of the same line are fitted together.
        scene: packaged name, TOML file, plain values or a `Scene`; its values are the start values.
        free: paths of parameters, or unique last names such as `b_l`; default: those listed in the scene's `[fit]`,
            otherwise its damping.
        method: `shooting` (Gauss-Newton over joined windows), `windows` (separate ones), `gradient`, a `Method`, or a
            `GradientDescent`.
        loss: `squares`, `huber`, `student` or a `Loss` such as `Huber(2.0)`. Student's t starts from the end of
            Huber's and is for traces with outliers.
        start, bounds, priors: by name: start value; (low, high); (mean, standard deviation). Priors from the scene's
            `[fit]` apply to parameters without one here.
        until: samples from this time [s] on are not fitted.
        held_out: (low, high) [s] that are not fitted but scored; only their starts are fitted, afterwards.
        settings: how traces are read and cut into windows.
        progress: called with (fraction, text).

    Raises:
        SceneError: for any invalid input, in one line.
    """
    method = as_method(method)
    loss = as_loss(loss)
    progress = progress or silent
    whole = prepare(
        traces,
        scene,
        free,
        start=start,
        bounds=bounds,
        priors=priors,
        until=until,
        held_out=held_out,
        settings=settings,
        progress=progress,
    )
    prepared = with_sound_windows(whole, loss, method.iterations, progress)
    if method.name == "gradient":  # the descent is separate: it only takes the windows of the other fit
        prepared = replace(prepared, begin=whole.begin, starts=prepared.starts_from_samples())
        left = method.iterations
    else:
        left = max(method.iterations - prepared.iterations, min(method.iterations - 1, FIRST), 1)
    solution = estimate(prepared, replace(method, iterations=left), loss, progress)
    solution.iterations += prepared.iterations
    result = explain(summarise(prepared, method.name, solution), whole)
    if free is None and not settings.fixed and (whole.scene.fit is None or not whole.scene.fit.free):
        result = complete_law(result, method, loss, progress)
    if result.status == "misfit" and not result.wrong_file and method.name != "gradient":
        result.tested = advise(result)
        result.likely = likeliest(result)
    progress(1.0, result.status)
    return result


def fit_and_free(
    traces: TracesLike,
    scene: SceneLike,
    free: Sequence[str] | None = None,
    *,
    method: Method | GradientDescent | str = "shooting",
    loss: Loss | str = LEAST_SQUARES,
    progress: Progress | None = None,
    **options: Any,
) -> FitResult:
    """The fit with what the traces show to be wrong freed too, one candidate at a time, while the fit improves.

    Args:
        traces, scene, free, method, loss, progress: as of `fit`.
        **options: the other arguments of `fit`.
    """
    chosen = as_method(method)
    loss = as_loss(loss)
    progress = progress or silent
    whole = prepare(traces, scene, free, progress=progress, **options)
    refuse_tied("auto_free", whole.parameters)

    def again(prepared: Prepared, method: str, loss: Loss, *, frozen: np.ndarray | None = None) -> Solution:
        return estimate(prepared, replace(chosen, name=method), loss, progress, frozen)

    if any(trace.recordings for trace in whole.traces):
        raise SceneError("auto-free: only for separate runs. Fit recordings of one motion without it, with --advice")
    started = whole.started
    sound = with_sound_windows(whole, loss, chosen.iterations, progress, keep_jumps=True)
    kicks: list[Candidate] = []
    if sound.left_out or sound.windows.count > whole.windows.count:  # some windows were lost
        whole, kicks = without_kicks(whole, again, loss)
        if kicks:
            sound = with_sound_windows(whole, loss, chosen.iterations, progress, keep_jumps=True)
    joined = "shooting" if chosen.name == "gradient" else chosen.name
    at = free_by_advice(sound, again, joined, loss, progress=progress)
    freed: list[Candidate | LawTest] = [*kicks, *at.names]
    doubt = omitted_parameter_bias([*kicks, *at.names], at.prepared.parameters)
    prepared = at.prepared
    solution = at.solution
    if chosen.name == "gradient":
        solution = again(prepared, "gradient", at.loss)
    known = replace(prepared.known, doubt=doubt)
    solution.problem = replace(solution.problem, known=known)
    solution.iterations += prepared.iterations
    result = summarise(replace(prepared, started=started, known=known), chosen.name, solution)
    result = explain(free_laws(result, chosen, at.loss, freed, progress), whole)
    result.add_advice(at.found)
    progress(1.0, result.status)
    return result


def free_laws(
    result: FitResult,
    method: Method | GradientDescent | str = "shooting",
    loss: Loss = LEAST_SQUARES,
    freed: Sequence[Candidate | LawTest] = (),
    progress: Progress = silent,
) -> FitResult:
    """The fit with the forces that its traces show freed too, one after another, from its end.

    Args:
        result: of a fit by this method and loss.
        freed: what was freed before.
    """
    method = as_method(method)
    found = list(freed)
    while result.status == "model_error" and result.laws.wrong.free and len(found) < MOST_FREED:
        found.append(result.laws.wrong)
        law = with_law(result.prepared, result.laws.wrong.free, result.solution)
        result = summarise(law, method.name, estimate(law, method, loss, progress))
    result.freed = found
    return result


#: Forces that a misfit frees in turn, and how many of them are tried.
MOST_TRIED = 2


def complete_law(
    result: FitResult, method: Method | GradientDescent, loss: Loss = LEAST_SQUARES, progress: Progress = silent
) -> FitResult:
    """The fit with one more force of the damping law if the scene's own forces miss the trace and it explains them.

    For fits with the default free parameters: the scene's damping is then a first guess of the law. Score tests are
    too weak where a misfit is far above the noise (measured single pendulum without its quadratic drag: t = 1.1,
    although freeing it halves the error of stretches that were not fitted), so that forces are fitted in turn.
    """
    if result.status != "misfit" or result.wrong_file:
        return result
    order = sorted((test for test in result.laws.tests if test.free), key=lambda test: test.name != QUADRATIC)
    for test in order[:MOST_TRIED]:
        law = with_law(result.prepared, test.free, result.solution)
        found = summarise(law, method.name, estimate(law, method, loss, progress))
        if found.status == "ok":
            found.freed = [test]
            found.warnings.append(
                f"the scene's damping misses the trace: {test.name} ({', '.join(test.free)}) was freed too; "
                "--fixed, --free or [fit] keep the law"
            )
            return found
    return result


def explain(result: FitResult, prepared: Prepared) -> FitResult:
    """The result with the mistake in the traces that explains a misfit, if there is one.

    Args:
        prepared: with all windows.
    """
    if result.status != "ok" or result.chi2_per_dof > SUSPECT:
        result.wrong_file = name_wrong_file(prepared)
    return result


def likeliest(result: FitResult) -> str:
    """The force or the number of the scene that explains most of a misfit, and what frees it; empty if none does."""
    candidates = [candidate for candidate in result.tested if candidate.worth_naming][:1]
    candidates += [test for test in result.laws.significant if test.free][:1]
    best = max(candidates, key=lambda candidate: candidate.gain, default=None)
    if best is None:
        return ""
    return f"{best.name}; {free_too(result.prepared, best.free)}"
