"""`fit`: from traces and a scene to calibrated parameters with their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from dropper_jax.modelling.build import SceneLike
from fitting.calibration.advice import advise
from fitting.calibration.candidate import Candidate, omitted_parameter_bias
from fitting.calibration.comparison import refuse_tied
from fitting.calibration.file_diagnosis import SUSPECT_CHI_SQUARE, name_wrong_file
from fitting.calibration.free_by_advice import free_by_advice
from fitting.calibration.freeing import MOST_FREED
from fitting.calibration.kicks import without_kicks
from fitting.calibration.likely_cause import freeing_advice
from fitting.calibration.result import FitResult
from fitting.calibration.summarise import summarise
from fitting.estimate.loss import LEAST_SQUARES, Loss, as_loss
from fitting.estimate.solution import Solution
from fitting.laws.law_candidates import QUADRATIC
from fitting.laws.law_fits import with_law
from fitting.laws.law_tests import LawTest
from fitting.parameters.parameter import Bounds, Priors, StartValues
from fitting.windows.fit_settings import AUTOMATIC, FitSettings
from fitting.windows.method import Method, as_method, estimate
from fitting.windows.preparation import TracesLike, prepare
from fitting.windows.prepared import Prepared
from fitting.windows.sound_windows import FIRST_ITERATIONS, with_sound_windows
from fitting.windows.spans import Interval

if TYPE_CHECKING:
    from fitting.estimate.descent import GradientDescent


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
    held_out: Sequence[Interval] = (),
    settings: FitSettings = AUTOMATIC,
    progress: Progress = silent,
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
        left = max(method.iterations - prepared.iterations, min(method.iterations - 1, FIRST_ITERATIONS), 1)
    solution = estimate(prepared, replace(method, iterations=left), loss, progress)
    solution.iterations += prepared.iterations
    result = with_wrong_file(summarise(prepared, method.name, solution), whole)
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
    progress: Progress = silent,
    **options: Any,
) -> FitResult:
    """The fit with what the traces show to be wrong freed too, one candidate at a time, while the fit improves.

    Args:
        traces, scene, free, method, loss, progress: as of `fit`.
        **options: the other arguments of `fit`.
    """
    chosen = as_method(method)
    loss = as_loss(loss)
    whole = prepare(traces, scene, free, progress=progress, **options)
    refuse_tied("auto_free", whole.parameters)
    if any(trace.recordings for trace in whole.traces):
        raise SceneError("auto-free: only for separate runs. Fit recordings of one motion without it, with --advice")

    def again(prepared: Prepared, method: str, loss: Loss, *, frozen: np.ndarray | None = None) -> Solution:
        return estimate(prepared, replace(chosen, name=method), loss, progress, frozen)

    sound = with_sound_windows(whole, loss, chosen.iterations, progress, keep_jumps=True)
    kicks: list[Candidate] = []
    if sound.left_out or sound.windows.count > whole.windows.count:  # some windows were lost
        whole, kicks = without_kicks(whole, again, loss)
        if kicks:
            sound = with_sound_windows(whole, loss, chosen.iterations, progress, keep_jumps=True)
    by_gradient = chosen.name == "gradient"
    joined = "shooting" if by_gradient else chosen.name
    end = free_by_advice(sound, again, joined, loss, progress=progress)
    freed = [*kicks, *end.freed]
    prepared = end.prepared
    solution = end.solution
    if by_gradient:
        solution = again(prepared, "gradient", end.loss)
    known = replace(prepared.known, doubt=omitted_parameter_bias(freed, prepared.parameters))
    solution.problem = replace(solution.problem, known=known)
    solution.iterations += prepared.iterations
    result = summarise(replace(prepared, known=known), chosen.name, solution)
    result = with_wrong_file(free_laws(result, chosen, end.loss, freed, progress), whole)
    result.add_advice(end.tested)
    progress(1.0, result.status)
    return result


def free_laws(
    result: FitResult,
    method: Method,
    loss: Loss,
    freed: Sequence[Candidate | LawTest] = (),
    progress: Progress = silent,
) -> FitResult:
    """The fit with the forces that its traces show freed too, one after another, from its end.

    Args:
        result: of a fit by this method and loss.
        freed: what was freed before.
    """
    all_freed = list(freed)
    while result.status == "model_error" and len(all_freed) < MOST_FREED:
        wrong = result.laws.wrong
        if wrong is None or not wrong.free:
            break
        all_freed.append(wrong)
        result = fit_with_force(result, wrong, method, loss, progress)
    result.freed = all_freed
    return result


def fit_with_force(result: FitResult, test: LawTest, method: Method, loss: Loss, progress: Progress) -> FitResult:
    """The fit with a force of the score tests free too, from its end."""
    law = with_law(result.prepared, test.free, result.solution)
    return summarise(law, method.name, estimate(law, method, loss, progress))


#: Maximum number of forces that a misfit frees in turn.
MOST_TRIED = 2


def complete_law(result: FitResult, method: Method, loss: Loss, progress: Progress) -> FitResult:
    """The fit with one more force of the damping law if the scene's own forces miss the trace and it explains them.

    For fits with the default free parameters: the scene's damping is then a first guess of the law. Score tests are
    too weak where a misfit is far above the noise (measured single pendulum without its quadratic drag: t = 1.1,
    although freeing it halves the error of stretches that were not fitted), so that forces are fitted in turn.
    """
    if result.status != "misfit" or result.wrong_file:
        return result
    order = sorted((test for test in result.laws.tests if test.free), key=lambda test: test.name != QUADRATIC)
    for test in order[:MOST_TRIED]:
        wider = fit_with_force(result, test, method, loss, progress)
        if wider.status == "ok":
            wider.freed = [test]
            wider.warnings.append(
                f"the scene's damping misses the trace: {test.name} ({', '.join(test.free)}) was freed too; "
                "--fixed, --free or [fit] keep the law"
            )
            return wider
    return result


def with_wrong_file(result: FitResult, prepared: Prepared) -> FitResult:
    """The result with the mistake in the traces that explains a misfit, if there is one.

    Args:
        prepared: with all windows.
    """
    if result.status != "ok" or result.chi2_per_dof > SUSPECT_CHI_SQUARE:
        result.wrong_file = name_wrong_file(prepared)
    return result


def likeliest(result: FitResult) -> str:
    """The force or the number of the scene that explains most of a misfit, and what frees it; empty if none does."""
    candidate = next((one for one in result.tested if one.worth_naming), None)
    test = next((one for one in result.laws.significant if one.free), None)
    best = max(filter(None, (candidate, test)), key=lambda one: one.gain, default=None)
    if best is None:
        return ""
    return f"{best.name}; {freeing_advice(result.prepared, best.free)}"
