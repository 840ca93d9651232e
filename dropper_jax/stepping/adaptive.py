"""Steps that follow a required accuracy: one whose local error is too large is rejected and repeated.

The error and the next length are those of `step_control`. A step that does not converge is rejected like one that is
too long. Steps end at the saved times, which are evenly spaced, and at times at which an effect is not smooth
(`Model.corners`). Steps of the shortest length are accepted at any error, and counted.

Lengths of steps are not differentiated: derivatives of a run, in forward mode, are those with the lengths held
constant, up to corners that depend on a parameter.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.model import Model, State
from dropper_jax.residual import Embedded, Stepper, explicit_row, step_and_filter
from dropper_jax.stepping.extremes import Extremes, Watch, no_extremes, with_step
from dropper_jax.stepping.halving import ROUNDING, step_failed
from dropper_jax.stepping.progress import Progress, TensionMeans, Trajectory, begin
from dropper_jax.stepping.step_change import books_changes, with_step_changed
from dropper_jax.stepping.step_control import (
    MOST,
    ORDER,
    Control,
    after_step,
    allowed_error,
    error_rows,
    next_length,
    relative_error,
    shortest_step,
)

#: Error of a repeated step relative to what is allowed, above which the step is divided. Without the limit, 7 of 12
#: runs of a snapping rope without internal damping reached 10 to 100 times its tension. With 10, one of 9 reached 5.
GROSS = 3.0
#: A step within this factor of a shortest one counts as it, for rounding.
AT_SHORTEST = 1.01


class _IntervalProgress(NamedTuple):
    """State of the loop over the steps of one interval.

    Attributes:
        residual: maximum scaled residual of the accepted steps.
        retried: number of steps repeated because they did not converge.
        failed: number of accepted steps that ended above tolerance.
        extremes: of the watched signals, if signals are watched.
    """

    progress: Progress
    within: TensionMeans
    residual: Array
    retried: Array
    failed: Array
    extremes: Extremes | None


def follow_and_save(
    stepper: Stepper, model: Model, progress: Progress, dt: Array, accuracy: Array, watch: Watch | None = None
) -> tuple[Progress, Trajectory]:
    """Advance by an interval of dt [s] in steps whose local error the accuracy allows, and save the result.

    The saved tension is the mean over the interval; signals of `watch` have their extremes over all steps.
    """
    end = progress.t + dt
    start = _start_of_interval(progress, no_extremes(watch, model, progress.state))

    def before_end(done: _IntervalProgress) -> Array:
        return done.progress.t < end - ROUNDING * dt

    def attempt(done: _IntervalProgress) -> _IntervalProgress:
        tried = _try_step(stepper, model, done.progress, end, dt, accuracy)
        within = done.within
        tension = midstep_tension(stepper, done.progress.state.tension, tried.progress.state.tension)
        taken = done._replace(
            within=TensionMeans(
                within.mean + tried.h / dt * tension,
                within.square + tried.h / dt * tension**2,
                within.steps + 1,
            ),
            residual=jnp.maximum(done.residual, tried.row),
            failed=done.failed + tried.failed,
            extremes=with_step(done.extremes, watch, model, done.progress.state, tried.progress.state),
        )
        after = jax.tree.map(lambda a, b: jnp.where(tried.accepted, a, b), taken, done)
        repeated = tried.failed & ~tried.accepted
        return after._replace(progress=tried.progress, retried=done.retried + repeated)

    done = jax.lax.while_loop(before_end, attempt, start)
    progress = done.progress._replace(done=done.progress.done + 1)
    return progress, _row_of_interval(stepper, model, done)


def _start_of_interval(progress: Progress, extremes: Extremes | None) -> _IntervalProgress:
    """The loop before its first step."""
    no_steps = jnp.zeros((), jnp.int32)
    no_tension = jnp.zeros_like(progress.state.tension)
    return _IntervalProgress(
        progress=progress,
        within=TensionMeans(no_tension, no_tension, no_steps),
        residual=jnp.zeros((), progress.state.r.dtype),
        retried=no_steps,
        failed=no_steps,
        extremes=extremes,
    )


def _row_of_interval(stepper: Stepper, model: Model, done: _IntervalProgress) -> Trajectory:
    """What is saved after the last step of an interval."""
    s = done.progress.state
    work = s.work
    if books_changes(stepper, model):
        work = jnp.append(work, control_of(done.progress).changed)
    return Trajectory(
        r=s.r,
        v=s.v,
        tension=done.within.mean,
        work=work,
        residual=done.residual,
        retried=done.retried,
        failed=done.failed,
        first_bad=done.progress.first_bad,
        parted=s.parted,
        own=s.own,
        extremes=done.extremes,
        within=done.within,
    )


def control_of(progress: Progress) -> Control:
    """The controller of a run that follows an accuracy."""
    if progress.control is None:
        raise ValueError("progress: its steps are equal. Use `begin(..., follows=True)` for a run with an accuracy")
    return progress.control


def accepted_steps(run: Trajectory) -> Array:
    """Number of steps of a run by `advance` with an accuracy."""
    if run.within is None:
        raise ValueError("run: does not count its steps. Use `advance` with an accuracy")
    return jnp.sum(run.within.steps)


class _Tried(NamedTuple):
    """A step that was tried.

    Attributes:
        progress: the run after it, or before it with a shorter step wanted if it is not accepted.
        h: its length [s].
        row: its largest scaled row.
        failed: whether it did not converge, or gave values that are not finite.
        accepted: whether it is a step of the run.
    """

    progress: Progress
    h: Array
    row: Array
    failed: Array
    accepted: Array


def _try_step(stepper: Stepper, model: Model, progress: Progress, end: Array, dt: Array, accuracy: Array) -> _Tried:
    """Try the next step of an interval of dt [s] that ends at `end` [s]."""
    s = progress.state
    first_bad = progress.first_bad
    record = progress.record
    control = control_of(progress)
    h, stop, repeats = _choose_length(model, progress, control, end, dt)
    start, added = with_step_changed(stepper, model, s, control.before, h)
    s1, row, excess = _step_with_error(stepper, model, start, h, control, accuracy)
    s1 = replace(s1, t=jnp.where(s1.t < stop - ROUNDING * dt, s1.t, stop))
    failed = step_failed(stepper, model, s1, row)
    excess = jnp.where(failed | ~jnp.isfinite(excess), MOST, excess)
    floor = shortest_step(stepper, model)
    last_resort = floor * 0.5**stepper.halvings
    is_last_resort = h <= AT_SHORTEST * last_resort
    has_failed = first_bad >= 0  # a failed run continues to its end with any error
    is_solved = ~failed | is_last_resort | has_failed
    is_exact = excess <= 1.0
    is_shortest = h <= AT_SHORTEST * floor
    is_close_repeat = repeats & (excess <= GROSS)
    accepted = is_solved & (is_exact | is_shortest | has_failed | is_close_repeat)
    least = jnp.where(failed, last_resort, jnp.minimum(floor, h))
    wanted = jnp.clip(next_length(h, excess, control, accepted), least, dt)
    wanted = jnp.where(has_failed, dt, wanted)
    next_control = after_step(model, s1, h, excess, wanted, control)
    next_control = next_control._replace(shortest=control.shortest + ~is_exact, changed=control.changed + added)
    first_bad = jnp.where(failed & ~has_failed, progress.done, first_bad)
    taken = Progress(s1, progress.done, first_bad, next_control)
    retry_control = control._replace(wanted=wanted, rejected=~accepted, refused=control.refused + 1)
    unchanged = progress._replace(control=retry_control, record=None)
    chosen = jax.tree.map(lambda a, b: jnp.where(accepted, a, b), taken, unchanged)
    if record is not None:
        chosen = chosen._replace(record=record.with_step(h, accepted))
    return _Tried(chosen, h, row, failed, accepted)


def _step_with_error(
    stepper: Stepper, model: Model, s: State, h: Array, control: Control, accuracy: Array
) -> tuple[State, Array, Array]:
    """The state after a step of h [s], the largest scaled row, and the error relative to what the accuracy allows."""
    scheme = stepper.integrator
    if isinstance(scheme, Embedded):
        allowed = allowed_error(accuracy, model.dtype)
        s1, error = scheme.advance_with_error(model, s, h, allowed)
        return s1, explicit_row(model, s, s1), jax.lax.stop_gradient(error) ** (ORDER / scheme.order)
    s1, row, error = step_and_filter(stepper, model, s, h, error_rows(stepper, control.before))
    return s1, row, relative_error(model, s, s1, h, error, control, accuracy)


def _choose_length(
    model: Model, progress: Progress, control: Control, end: Array, dt: Array
) -> tuple[Array, Array, Array | bool]:
    """Length [s] of the next step, the time [s] at which it or a later one must end, and whether the length is one of
    a record that is repeated."""
    t = progress.t
    stop = _next_stop(model, t, end, dt)
    left = stop - t
    h = left / jnp.ceil(jax.lax.stop_gradient(left) / control.wanted - ROUNDING)
    record = progress.record
    if record is None:
        return h, stop, False
    return record.next_length(control, h), stop, record.repeats


def midstep_tension(stepper: Stepper, before: Array, after: Array) -> Array:
    """Tensions (..., n) [N] in the middle of a step, from those that the last step and this one report."""
    late = stepper.integrator.tension_time - 0.5
    if not late:
        return after
    return (1.0 - late) * after + late * before


def _next_stop(model: Model, t: Array, end: Array, dt: Array) -> Array:
    """The end of the interval of dt, or a time before it at which an effect is not smooth [s].

    It is that time, to the last bit, if the end is the same but for rounding: effects switch there.
    """
    if model.corners is None:
        return end
    rounding = ROUNDING * dt
    first = jnp.min(jnp.where(model.corners > t + rounding, model.corners, jnp.inf))
    return jnp.where(first < end + rounding, first, end)


def find_lengths(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: Array,
    intervals: int | Array,
    accuracy: Array,
    most: int,
) -> tuple[Array, Array, Array]:
    """Lengths (most,) [s] of the steps of `intervals` of dt [s] from s that follow an accuracy, their number, and
    whether a step failed or steps are left out."""
    progress = begin(stepper, model, s, follows=True)
    last = progress.t + intervals * dt

    def before_end(carry: tuple[Progress, Array, Array]) -> Array:
        return (carry[0].t < last - ROUNDING * dt) & (carry[2] < most)

    def attempt(carry: tuple[Progress, Array, Array]) -> tuple[Progress, Array, Array]:
        progress, lengths, number = carry
        end = s.t + dt * (jnp.floor((progress.t - s.t) / dt + ROUNDING) + 1.0)
        tried = _try_step(stepper, model, progress, end, dt, accuracy)
        lengths = lengths.at[number].set(jnp.where(tried.accepted, tried.h, 0.0))
        return tried.progress, lengths, number + tried.accepted

    nothing = jnp.zeros(most, model.dtype), jnp.zeros((), jnp.int32)
    end, lengths, number = jax.lax.while_loop(before_end, attempt, (progress, *nothing))
    return lengths, number, end.has_failed | (end.t < last - ROUNDING * dt)


def interval_ends(length: Array, dt: float | Array, intervals: int) -> Array:
    """Number of steps of these lengths (most,) [s] up to the end of each of the intervals of dt [s]."""
    ends = jnp.searchsorted(jnp.cumsum(length), dt * (1.0 + jnp.arange(intervals)) * (1.0 - ROUNDING)) + 1
    return jnp.minimum(ends, len(length)).astype(jnp.int32)
