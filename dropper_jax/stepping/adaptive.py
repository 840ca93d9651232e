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
from dropper_jax.residual import Stepper
from dropper_jax.stepping.extremes import Extremes, Watch, no_extremes, with_step
from dropper_jax.stepping.halving import ROUNDING, step_failed
from dropper_jax.stepping.progress import Progress, Trajectory, Within, begin
from dropper_jax.stepping.step_change import books_changes, with_step_changed
from dropper_jax.stepping.step_control import MOST, Control, after_step, next_length, shortest_step, try_step

#: Error of a repeated step relative to what is allowed, of second order, from which it is divided. Without it 7 of 12
#: runs of a snapping rope without internal damping reached 10 to 100 times its tension, with 10 one of 9 five times.
GROSS = 3.0
#: A failed run continues to its end with any error.
LAST_RESORT = 1.01


class _Interval(NamedTuple):
    """State of the loop over the steps of one interval."""

    progress: Progress
    within: Within
    residual: Array
    retried: Array
    bad: Array
    extremes: Extremes | None


def follow_and_save(
    stepper: Stepper, model: Model, progress: Progress, dt: Array, accuracy: Array, watch: Watch | None = None
) -> tuple[Progress, Trajectory]:
    """Advance by an interval of dt [s] in steps whose local error the accuracy allows, and save the result.

    The saved tension is the mean over the interval; signals of `watch` have their extremes over all steps.
    """
    s = progress.state
    none = jnp.zeros((), jnp.int32)
    end = s.t + dt
    nothing = jnp.zeros_like(s.tension)
    within = Within(nothing, nothing, none)
    start = _Interval(progress, within, jnp.zeros((), model.dtype), none, none, no_extremes(watch, model, s))

    def before_end(done: _Interval) -> Array:
        return done.progress.t < end - ROUNDING * dt

    def attempt(done: _Interval) -> _Interval:
        tried = _try(stepper, model, done.progress, end, dt, accuracy)
        within = done.within
        tension = _in_the_middle(stepper, done.progress.state, tried.progress.state)
        taken = done._replace(
            within=Within(
                within.mean + tried.h / dt * tension,
                within.square + tried.h / dt * tension**2,
                within.steps + 1,
            ),
            residual=jnp.maximum(done.residual, tried.row),
            bad=done.bad + tried.failed,
            extremes=with_step(done.extremes, watch, model, done.progress.state, tried.progress.state),
        )
        after = jax.tree.map(lambda a, b: jnp.where(tried.accepted, a, b), taken, done)
        repeated = tried.failed & ~tried.accepted
        return after._replace(progress=tried.progress, retried=done.retried + repeated)

    done = jax.lax.while_loop(before_end, attempt, start)
    progress = done.progress._replace(done=done.progress.done + 1)
    s = progress.state
    work = s.work
    if books_changes(stepper, model):
        work = jnp.append(work, control_of(progress).changed)
    counts = done.residual, done.retried, done.bad, progress.first_bad
    row = Trajectory(s.r, s.v, done.within.mean, work, *counts, s.parted, s.own, done.extremes, done.within)
    return progress, row


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
    """What follows a trial step: the run, with the step if it is accepted; its length, largest scaled row and fate."""

    progress: Progress
    h: Array
    row: Array
    failed: Array
    accepted: Array


def _try(stepper: Stepper, model: Model, progress: Progress, end: Array, dt: Array, accuracy: Array) -> _Tried:
    s = progress.state
    first_bad = progress.first_bad
    record = progress.record
    control = control_of(progress)
    stop = _next_stop(model, s.t, end, dt)
    left = stop - s.t
    h = left / jnp.ceil(jax.lax.stop_gradient(left) / control.wanted - ROUNDING)
    repeats = False
    if record is not None:
        repeats = record.repeats
        h = record.next_length(control, h)
    start, added = with_step_changed(stepper, model, s, control.before, h)
    s1, row, excess = try_step(stepper, model, start, h, control, accuracy)
    s1 = replace(s1, t=jnp.where(s1.t < stop - ROUNDING * dt, s1.t, stop))
    failed = step_failed(stepper, model, s1, row)
    excess = jnp.where(failed | ~jnp.isfinite(excess), MOST, excess)
    floor = shortest_step(stepper, model)
    last_resort = floor * 0.5**stepper.halvings
    solved = ~failed | (h <= LAST_RESORT * last_resort) | (first_bad >= 0)
    exact = excess <= 1.0
    accepted = solved & (exact | (h <= 1.01 * floor) | (first_bad >= 0) | (repeats & (excess <= GROSS)))
    least = jnp.where(failed, last_resort, jnp.minimum(floor, h))
    wanted = jnp.clip(next_length(h, excess, control, accepted), least, dt)
    wanted = jnp.where(first_bad >= 0, dt, wanted)
    following = after_step(model, s1, h, excess, wanted, control)
    following = following._replace(shortest=control.shortest + ~exact, changed=control.changed + added)
    first_bad = jnp.where(failed & (first_bad < 0), progress.done, first_bad)
    taken = Progress(s1, progress.done, first_bad, following)
    waiting = control._replace(wanted=wanted, rejected=~accepted, refused=control.refused + 1)
    left_alone = progress._replace(control=waiting, record=None)
    chosen = jax.tree.map(lambda a, b: jnp.where(accepted, a, b), taken, left_alone)
    if record is not None:
        chosen = chosen._replace(record=record.with_step(h, accepted))
    return _Tried(chosen, h, row, failed, accepted)


def _in_the_middle(stepper: Stepper, s: State, s1: State) -> Array:
    """Tensions (n,) [N] in the middle of a step, from those reported in this and the last one."""
    late = stepper.integrator.tension_time - 0.5
    return (1.0 - late) * s1.tension + late * s.tension if late else s1.tension


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
        tried = _try(stepper, model, progress, end, dt, accuracy)
        lengths = lengths.at[number].set(jnp.where(tried.accepted, tried.h, 0.0))
        return tried.progress, lengths, number + tried.accepted

    nothing = jnp.zeros(most, model.dtype), jnp.zeros((), jnp.int32)
    end, lengths, number = jax.lax.while_loop(before_end, attempt, (progress, *nothing))
    return lengths, number, end.has_failed | (end.t < last - ROUNDING * dt)


def interval_ends(length: Array, dt: float | Array, intervals: int) -> Array:
    """Number of steps of these lengths (most,) [s] up to the end of each of the intervals of dt [s]."""
    ends = jnp.searchsorted(jnp.cumsum(length), dt * (1.0 + jnp.arange(intervals)) * (1.0 - ROUNDING)) + 1
    return jnp.minimum(ends, len(length)).astype(jnp.int32)
