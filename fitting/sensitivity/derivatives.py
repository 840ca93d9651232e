"""Sensitivity of a quantity to parameters: local derivatives, exact or by differences, and their range of validity.

Local derivatives include the whole run and its static start, in forward and in reverse mode. In a chaotic motion they
grow like exp(lambda t) and soon do not predict the effect of a finite change. The horizon is the time until then.
Averages over windows shorter than the horizon remain meaningful beyond it.

In runs of elastic lines derivatives also grow where the motion does not, while links are slack. Their slopes are
differences of runs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from dropper_jax.model import Model, State, state
from dropper_jax.modelling.build import initial_state
from dropper_jax.run.chunks import FACTOR
from dropper_jax.stepping.halving import ROUNDING
from dropper_jax.stepping.integrate import Steps
from dropper_jax.stepping.progress import Trajectory
from dropper_jax.study.lyapunov import lyapunov
from fitting.parameters.forward_derivatives import WithSlopes, floats_of
from fitting.parameters.parameter import with_parameter_values
from fitting.sensitivity.differences import central_differences, error_of_value
from fitting.sensitivity.linear_range import CHANGE_SIZES, with_linear_range
from fitting.sensitivity.problem import Study, StudyProgram
from fitting.sensitivity.result import TANGENT, LocalDerivatives, empty_result, with_status
from fitting.sensitivity.study_runs import error_by_coarser, farthest
from fitting.sensitivity.study_steps import part_of_steps, saved_times
from fitting.sensitivity.tangents import differentiate_start, differentiate_study


@cached_jit(static=("plan",))
def _reverse(plan: StudyProgram, model: Model, near: State, values: Array, steps: Steps) -> Array:
    """Derivatives (p,) of the quantity by reverse mode."""
    return jax.grad(lambda p: plan.evaluate(model, near, p, steps, checkpoint=True))(values)


def local_derivatives(problem: Study, say: Progress = silent, check: bool = False) -> LocalDerivatives:
    """Derivatives of the study at its values, their errors and their range of validity.

    Of statics and of rigid lines they are exact. Of runs with links that stretch they are central differences of runs
    by 1 % of a parameter (0.6 % of a length) that take the steps of the study's own run, with an error from differences
    by 0.3 % (0.2 %) and from rounding (see `differences`).

    Exact ones are those along the steps of the study's own run; the error of its quantity by these steps is from a run
    with four times the accuracy. The same program runs once more with all parameters changed by 1 %, each in the
    direction that increases the quantity. If the derivatives do not predict this change within a third, smaller changes
    find their linear range. What they do not predict is their error. One run with the opposite change checks the
    derivatives along this direction.

    If they fail at 1 %, and 1 % of a parameter moves a node by more than 10 % of the motion's extent and by 10 times
    its displacement at the start, the derivatives are valid up to that time only. The same program then gives the
    means over windows.

    Args:
        check: also compute exact derivatives by reverse mode, and the Lyapunov exponent, by separate programs.
    """
    if not problem.has_elastic_links:
        found = _exact_derivatives(problem, say, check)
    else:
        found = central_differences(problem, say)
        if check:
            found = _with_check(problem, found, say)
    say(1.0, "ok")
    return found


def _exact_derivatives(problem: Study, say: Progress, check: bool) -> LocalDerivatives:
    """Exact derivatives, with their error and their range of validity."""
    at = jnp.asarray(problem.values, problem.model.dtype)
    say(0.0, "forward derivatives")
    start = differentiate_start(problem.plan, problem.model, problem.start, at)
    quantity, run = differentiate_study(problem, at, start, problem.steps)
    value = float(quantity.tree)
    forward = np.asarray(quantity.slopes[0])
    if not (np.isfinite(value) or problem.retries or problem.of.at_rest):
        return _exact_derivatives(replace(problem, retries=True), say, check)
    if np.isfinite(value):
        problem.check_derivatives(forward)
    found = replace(empty_result(problem, 0.0), value=value, forward=forward)
    moved = None
    if run is not None:
        moved = Displacements.of(problem, start, run)
        duration = problem.scene.run.rows * problem.scene.run.interval
        found = replace(found, horizon=duration, duration=duration, growth=moved.growth)
    if found.finite:
        found = replace(found, value_error=_error_of_steps(problem, at, start, value))
        say(0.3, "linear range")
        found = _with_changed_runs(problem, found, moved, run)
    if check:
        found = _with_check(problem, found, say)
    if moved is not None and found.finite and found.linear_range < CHANGE_SIZES[0]:
        found = _with_windows(problem, found, moved, run.tree, say)
    if found.finite and found.error is not None and found.linear_range == 0.0:
        found = with_status(problem, found, found.error, np.zeros(len(forward), bool))
    return found


def _with_changed_runs(
    problem: Study, found: LocalDerivatives, moved: Displacements | None, run: WithSlopes | None
) -> LocalDerivatives:
    """The result with the linear range and the error of its derivatives by runs with changed parameters, and the growth
    of the displacement of the first of them."""
    changed_runs = []

    def evaluate(values: np.ndarray) -> float:
        quantity, changed_run = changed_study(problem, values)
        changed_runs.append(changed_run)
        return quantity

    found = with_linear_range(problem, found, evaluate)
    found.warnings.extend(error_of_value(problem, found))
    first = changed_runs[0]  # with all parameters changed by 1 %
    if moved is None or run is None or first is None:
        return found
    return replace(found, motion_growth=moved.growth_of_change(farthest(first.tree.r, run.tree.r)))


def _with_windows(
    problem: Study, found: LocalDerivatives, moved: Displacements, run: Trajectory, say: Progress
) -> LocalDerivatives:
    """The result with the time up to which its derivatives are valid and, if that is before the end of the run, their
    means over windows."""
    limit, rate = moved.horizon(saved_times(problem.steps))
    if limit >= found.duration:
        return found
    say(0.7, "windows")
    mean, spread, length = window_means(problem, min(limit, found.duration / 2), run)
    if found.exponent is not None:  # that of small errors, which was asked for
        rate = found.exponent
    return replace(found, horizon=limit, exponent=rate, window=length, window_mean=mean, window_error=spread)


def _with_check(problem: Study, found: LocalDerivatives, say: Progress) -> LocalDerivatives:
    """The result with the growth rate of small errors, and derivatives by reverse mode if they are exact."""
    settings = problem.scene.run
    if found.method == TANGENT:
        say(0.4, "reverse derivatives")
        at = jnp.asarray(problem.values, problem.model.dtype)
        reverse = np.asarray(_reverse(problem.plan, problem.model, problem.start, at, problem.steps))
        if found.finite:
            problem.check_derivatives(reverse)
        found = replace(found, reverse=reverse)
    growth = lyapunov(problem.model, problem.start, problem.stepper, settings.step, max(settings.steps, 2))
    return replace(found, exponent=float(growth.exponent))


def _error_of_steps(problem: Study, at: Array, start: WithSlopes, value: float) -> float:
    """The error of the quantity by a run with four times the accuracy; NaN if a step fails, or steps are equal."""
    settings = problem.scene.run
    if problem.of.at_rest or settings.accuracy is None:
        return np.nan
    # steps end at the saved times: with as many of them, those of both would be equal where intervals are short
    duration = settings.rows * settings.interval
    interval = duration / max(settings.rows // 2, 1)
    accuracy = min(FACTOR * settings.accuracy, 1.0)
    coarser = replace(settings, accuracy=accuracy, save_interval=interval, duration=duration)
    quantity, _ = differentiate_study(problem, at, start, problem.steps_of(coarser))
    return error_by_coarser(problem.of, value, float(quantity.tree), settings.accuracy)


class Displacements(NamedTuple):
    """Displacements of the farthest node by 100 % of each parameter, as the derivatives predict them.

    Attributes:
        at_start: (p,) [m].
        at_saves: at saved times (saves, p) [m].
        extent: of the motion [m].
    """

    at_start: np.ndarray
    at_saves: np.ndarray
    extent: float

    @classmethod
    def of(cls, problem: Study, start: WithSlopes, run: WithSlopes) -> Displacements:
        """Those of a run from a start."""
        scale = np.array([p.scale for p in problem.parameters])
        at_start, at_saves = (np.linalg.norm(x.slopes[0], axis=-1).max(-1).T * scale for x in (start, run))
        return cls(at_start, at_saves, farthest(run.tree.r, run.tree.r[0]))

    @property
    def growth(self) -> float:
        """Logarithm of the largest displacement over that at the start, or the extent of the motion if that is larger;
        infinite if they overflow."""
        if not np.isfinite(self.at_saves).all():
            return np.inf
        before = np.maximum(np.maximum(self.extent, self.at_start), np.finfo(float).tiny)
        return float(np.log(np.max(self.at_saves / before, initial=1.0)))

    def horizon(self, times: np.ndarray) -> tuple[float, float]:
        """Time [s] up to which the derivatives are valid (see `local_derivatives`), at most the last of the saved
        times, and their mean growth rate [1/s] over the second half of the run, NaN if they are valid to its end.

        A sea that is calm, or still rises, moves a line less than a change of its length does at the start.
        """
        size = (self.at_saves / (10.0 * np.maximum(self.extent, self.at_start))).max(axis=-1)
        over = np.flatnonzero(~(size[:-1] <= 1.0))
        if not over.size:
            return float(times[-1]), np.nan
        middle = len(size) // 2 - 1
        return float(times[over[0]]), float(np.log(size[-1] / size[middle]) / (times[-1] - times[middle]))

    def growth_of_change(self, moved: float) -> float:
        """Logarithm of the displacement [m] by a change of all parameters by 1 %, over that at the start or 1 % of the
        motion."""
        before = 0.01 * max(self.extent, float(np.sum(self.at_start)), np.finfo(float).tiny)
        return float(np.log(max(moved / before, 1.0)))


def changed_study(problem: Study, values: np.ndarray) -> tuple[float, WithSlopes | None]:
    """The quantity with these values (p,), NaN if the scene has no start with them; and its run."""
    at = jnp.asarray(values, problem.model.dtype)
    try:
        s = initial_state(with_parameter_values(problem.model, problem.parameters, at), problem.scene.start)
    except SceneError:
        return np.nan, None
    start = without_slopes(s, len(at))
    quantity, run = differentiate_study(problem, at, start, problem.steps)
    return float(quantity.tree), run


def without_slopes(s: State, count: int) -> WithSlopes:
    """A start that the parameters do not change."""
    return WithSlopes(s, [jnp.asarray(np.zeros((count, *x.shape)), x.dtype) for x in floats_of(s)])


def window_means(problem: Study, length: float, run: Trajectory) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean derivative of the quantity over windows of about `length` [s] that start on the motion itself, a run.

    Each window's start is fixed, so that derivatives only accumulate within the window. The result is the effect of a
    parameter on the quantity within one horizon, averaged over the states of the motion.

    Returns:
        mean and standard error (p,), and the windows' length [s].
    """
    steps = problem.steps
    times = np.append(0.0, saved_times(steps))
    # of as many saved states each; those of steps that follow an accuracy need not be evenly spaced
    share = length / times[-1] * (1.0 + ROUNDING)
    saves = min(max(2, int(share * len(steps.ends))), len(steps.ends))
    count = len(steps.ends) // saves
    at = jnp.asarray(problem.values, problem.model.dtype)
    model = with_parameter_values(problem.model, problem.parameters, at)
    found = []
    s = state(model, problem.start.r, problem.start.v, problem.start.tension)
    for i in range(count):
        first = i * saves
        if i:
            last = jax.tree.map(lambda x, k=first - 1: x[k], run)
            s = state(model, last.r, last.v, last.tension, times[first])
            s = replace(s, parted=last.parted, own=last.own)
        quantity, _ = differentiate_study(problem, at, without_slopes(s, len(at)), part_of_steps(steps, first, saves))
        found.append(np.asarray(quantity.slopes[0]))
    if count > 1:
        error = np.std(found, axis=0, ddof=1) / np.sqrt(count)
    else:
        error = np.full(len(at), np.nan)
    return np.mean(found, axis=0), error, float(times[saves])
