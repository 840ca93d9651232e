"""`fit`: from traces and a scene to calibrated parameters with honest errors."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.progress import Progress, silent
from dropper_jax.run.build import SceneLike
from fitting.calibration.advice import advise, omitted_parameter_bias
from fitting.calibration.comparison import compare
from fitting.calibration.estimating import FIRST, estimate, with_sound_windows
from fitting.calibration.freeing import free_by_advice
from fitting.calibration.kicks import without_kicks
from fitting.calibration.preparation import TracesLike, prepare
from fitting.calibration.result import FitResult
from fitting.calibration.summary import summarise
from fitting.calibration.wrong_files import SUSPECT, name_wrong_file
from fitting.estimate.loss import loss_of
from fitting.estimate.scene_fit import Intervals
from fitting.parameters.parameter import Bounds, Priors, StartValues
from fitting.traces.trace import convention

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
    posterior: int = 0,
    sampler: str = "importance",
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
        posterior: number of draws of the parameters' posterior.
        sampler: `importance`, or `nuts`, which also samples window starts; `posterior` draws of each of four chains.
        progress: called with (fraction, text).
        **settings: of the gradient method: `optimizer` (`lbfgs`, `adam`, `sgd` or a transformation of optax),
            `learning_rate`, `steps`, `horizon`, `loss`; see `gradient.GradientDescent`.

    Raises:
        SceneError: for any invalid input, in one line.
    """
    if method not in METHODS:
        raise SceneError(f"method: {method!r} is unknown; {nearest(method, METHODS)}")
    if settings and method != "gradient":
        name = sorted(settings)[0]
        raise SceneError(f"{name}: {settings[name]!r} is not a setting of method {method!r}. Use method gradient")
    if method == "gradient":
        from fitting.estimate.gradient import descent_of  # noqa: PLC0415 - optax is slow to import

        descent_of(settings)  # rejects invalid settings before anything is compiled
    asked = Intervals(profile, bootstrap, posterior, sampler)
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
        progress=progress,
    )
    asked.profile_names(prepared.scene, prepared.parameters)  # rejects unknown names before anything is fitted
    loss = loss_of(huber, student, robust)
    sound = with_sound_windows(prepared, loss, iterations, progress, keep_jumps=auto_free)
    if method == "gradient" and not auto_free:  # the descent is separate: it only takes the windows of the other fit
        sound = replace(sound, begin=prepared.begin, starts=sound.starts_from_samples())
    whole, prepared = prepared, sound
    if auto_free:
        again = partial(estimate, continuity=continuity, iterations=iterations, progress=progress)
        kicked = []
        if sound.left_out or sound.windows.count > whole.windows.count:  # some windows were lost
            whole, kicked = without_kicks(whole, again, loss)
        if kicked:
            prepared = with_sound_windows(whole, loss, iterations, progress, keep_jumps=True)
        at = free_by_advice(prepared, again, "shooting" if method == "gradient" else method, loss, progress=progress)
        prepared, solution, found, freed = at.prepared, at.solution, at.found, [*kicked, *at.names]
        if method == "gradient":
            solution = estimate(prepared, method, at.loss, continuity, iterations, progress, settings)
    else:
        left = iterations if method == "gradient" else max(iterations - sound.iterations, min(iterations - 1, FIRST), 1)
        solution = estimate(prepared, method, loss, continuity, left, progress, settings)
        found = advise(prepared, solution) if advice and solution.status == "ok" else []
        freed = []
    prepared = replace(
        prepared,
        started=started,
        known=replace(prepared.known, doubt=omitted_parameter_bias(freed, prepared.parameters)),
    )
    solution.problem = replace(solution.problem, known=prepared.known)
    solution.iterations += prepared.iterations
    result = summarise(prepared, method, solution)
    if result.status != "ok" or result.chi2_per_dof > SUSPECT:
        result.wrong_file = name_wrong_file(whole)
        result.warnings[:0] = [result.wrong_file] if result.wrong_file else []
    result.advice, result.freed = found, freed
    # number of candidates listed in the warnings
    result.warnings += [str(candidate) for candidate in found if candidate.worth_naming][:3]
    asked.add_to(result, progress)
    if compare_models:
        result.comparison = compare(prepared.noisy(solution.problem.noise), progress=progress)
        result.seconds["run"] = time.perf_counter() - prepared.started - result.seconds["compile"]
    progress(1.0, result.status)
    return result
