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
import numpy as np
from jax import Array

from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.stepping.control import ROUNDING, step_failed
from dropper_jax.stepping.extremes import Extremes, Watch, no_extremes, with_step
from dropper_jax.stepping.integrate import (
    Loop,
    Progress,
    Steps,
    Trajectory,
    along_accepted_steps,
    begin,
    empty_rows,
    growth_meter,
    scan_steps,
)
from dropper_jax.stepping.step_change import books_changes, with_step_changed
from dropper_jax.stepping.step_control import (
    MOST,
    Control,
    after_step,
    next_length,
    shortest_step,
    start_control,
    try_step,
)

#: Error of a repeated step relative to what is allowed, of second order, from which it is divided. Without it 7 of 12
#: runs of a snapping rope without internal damping reached 10 to 100 times its tension, with 10 one of 9 five times.
GROSS = 3.0


#: Most steps of which a run keeps the lengths.
MOST_STEPS = 2**17


class Record(NamedTuple):
    """Lengths of the steps that a run accepts, for other runs that repeat them.

    A repeated step that does not converge, or whose error is gross, is divided: a rope of a changed run that snaps
    where the recorded one hangs still would gain energy without bound.

    Attributes:
        length: of the steps (most,) [s]; those after the first `most` are not recorded.
        number: of steps so far.
        repeats: whether the run takes these steps in place of its own.
        part: of a repeated step, what is done [s].
    """

    length: Array
    number: Array
    repeats: Array
    part: Array

    @classmethod
    def empty(cls, model: Model, most: int = MOST_STEPS) -> Record:
        """The record of a run that starts and chooses its steps."""
        return cls(
            length=jnp.zeros(most, model.dtype),
            number=jnp.zeros((), jnp.int32),
            repeats=jnp.zeros((), bool),
            part=jnp.zeros((), model.dtype),
        )

    def to_repeat(self) -> Record:
        """The record for a run that starts and takes the recorded steps."""
        return self._replace(number=jnp.zeros((), jnp.int32), repeats=jnp.ones((), bool))

    def next_length(self, control: Control, chosen: Array) -> Array:
        """The next step [s] in place of the chosen one."""
        left = self.length[self.number] - self.part
        divided = (self.part > 0.0) | control.rejected
        repeated = jnp.where(divided, jnp.minimum(control.wanted, left), left)
        return jnp.where(self.repeats, repeated, chosen)

    def with_step(self, h: Array, accepted: Array) -> Record:
        """The record after a step of h [s]."""
        now = self.length[self.number]
        length = jnp.where(accepted & ~self.repeats, h, now)
        lengths = jax.lax.dynamic_update_index_in_dim(self.length, length, self.number, axis=0)
        part = self.part + h
        whole = ~self.repeats | (part >= (1.0 - ROUNDING) * now)
        return Record(
            length=lengths,
            number=self.number + (accepted & whole),
            repeats=self.repeats,
            part=jnp.where(accepted, jnp.where(whole, 0.0, part), self.part),
        )


class Adaptive(NamedTuple):
    """State of a run with an accuracy.

    Attributes:
        progress: in intervals between saved times.
        control: what the controller remembers.
        refused: number of rejected steps.
        shortest: number of steps of the shortest length that were accepted with a larger error.
        changed: energy that changes of the step have added so far [J], see `Integrator.change_step`.
        record: of the steps, if it is wanted.
    """

    progress: Progress
    control: Control
    refused: Array
    shortest: Array
    changed: Array
    record: Record | None = None

    @property
    def state(self) -> State:
        """State of the line at the end of the last interval."""
        return self.progress.state

    @property
    def steps_done(self) -> Array:
        """Intervals done."""
        return self.progress.steps_done

    @property
    def t(self) -> Array:
        """Time reached [s]."""
        return self.progress.t

    @property
    def has_failed(self) -> Array:
        """Whether a step failed."""
        return self.progress.has_failed


class Within(NamedTuple):
    """Tensions between two saved times: mean and mean square, (k, n) each; steps (k,)."""

    mean: Array
    square: Array
    steps: Array


class _Interval(NamedTuple):
    """State of the loop over the steps of one interval."""

    adaptive: Adaptive
    within: Within
    residual: Array
    retried: Array
    bad: Array
    extremes: Extremes | None


def advance_adaptively(
    stepper: Stepper,
    model: Model,
    adaptive: Adaptive,
    dt: Array,
    accuracy: Array,
    saves: int,
    count: Array | np.integer | None = None,
    watch: Watch | None = None,
) -> tuple[Adaptive, tuple[Trajectory, Within]]:
    """Advance by `saves` intervals of dt [s], in steps whose local error the accuracy allows.

    Saved tensions are means over their interval; signals of `watch` have their extremes over all steps. With a `count`
    only this number of intervals is computed, and of `saves` rows the first are filled.
    """

    def save(adaptive: Adaptive, _: Array | None) -> tuple[Adaptive, tuple[Trajectory, Within]]:
        s = adaptive.state
        none = jnp.zeros((), jnp.int32)
        end = s.t + dt
        nothing = jnp.zeros_like(s.tension)
        within = Within(nothing, nothing, none)
        extremes = no_extremes(watch, model, s)
        start = _Interval(adaptive, within, jnp.zeros((), model.dtype), none, none, extremes)

        def before_end(done: _Interval) -> Array:
            return done.adaptive.t < end - ROUNDING * dt

        def attempt(done: _Interval) -> _Interval:
            tried = _try(stepper, model, done.adaptive, end, dt, accuracy)
            within = done.within
            tension = _in_the_middle(stepper, done.adaptive.state, tried.adaptive.state)
            taken = done._replace(
                within=Within(
                    within.mean + tried.h / dt * tension,
                    within.square + tried.h / dt * tension**2,
                    within.steps + 1,
                ),
                residual=jnp.maximum(done.residual, tried.row),
                bad=done.bad + tried.failed,
                extremes=with_step(done.extremes, watch, model, done.adaptive.state, tried.adaptive.state),
            )
            after = jax.tree.map(lambda a, b: jnp.where(tried.accepted, a, b), taken, done)
            repeated = tried.failed & ~tried.accepted
            return after._replace(adaptive=tried.adaptive, retried=done.retried + repeated)

        done = jax.lax.while_loop(before_end, attempt, start)
        s = done.adaptive.state
        progress = Progress(s, done.adaptive.steps_done + 1, done.adaptive.progress.first_bad)
        counts = done.residual, done.retried, done.bad, progress.first_bad
        work = s.work
        if books_changes(stepper, model):
            work = jnp.append(work, done.adaptive.changed)
        row = Trajectory(s.r, s.v, done.within.mean, work, *counts, s.parted, s.own, done.extremes)
        return done.adaptive._replace(progress=progress), (row, done.within)

    rows = empty_rows(jax.eval_shape(save, adaptive, None)[1], saves)
    return scan_steps(save, adaptive, saves if count is None else count, rows)


class _Tried(NamedTuple):
    """What follows a trial step: the run, with the step if it is accepted; its length, largest scaled row and fate."""

    adaptive: Adaptive
    h: Array
    row: Array
    failed: Array
    accepted: Array


#: A failed run continues to its end with any error.
LAST_RESORT = 1.01


def _try(stepper: Stepper, model: Model, adaptive: Adaptive, end: Array, dt: Array, accuracy: Array) -> _Tried:
    (s, number, first_bad), control, refused, shortest, changed, record = adaptive
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
    progress = Progress(s1, number, jnp.where(failed & (first_bad < 0), number, first_bad))
    following = after_step(model, s1, h, excess, wanted, control)
    taken = Adaptive(progress, following, refused, shortest + ~exact, changed + added)
    refused_control = control._replace(wanted=wanted, rejected=~accepted)
    left_alone = adaptive._replace(control=refused_control, refused=refused + 1, record=None)
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


def adaptive_step_lengths(
    stepper: Stepper, model: Model, s: State, dt: Array, intervals: int, accuracy: Array, most: int = 100_000
) -> tuple[Array, Array]:
    """Lengths (most,) [s] of the steps of `intervals` of dt [s] from s that follow an accuracy, and their number.

    A run along these steps, `integrate(stepper, model, s, lengths[:number], number)`, has derivatives in both modes
    with the steps held constant. Steps after the first `most` are left out.
    """
    return find_lengths(stepper, model, s, dt, intervals, accuracy, most)[:2]


def find_lengths(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: Array,
    intervals: int | Array,
    accuracy: Array,
    most: int,
) -> tuple[Array, Array, Array]:
    """The lengths of `adaptive_step_lengths`, their number, and whether a step failed or steps are left out."""
    adaptive = adaptive_start(stepper, model, begin(stepper, model, s))
    last = adaptive.t + intervals * dt

    def before_end(carry: Loop) -> Array:
        return (carry[0].t < last - ROUNDING * dt) & (carry[2] < most)

    def attempt(carry: Loop) -> Loop:
        adaptive, lengths, number = carry
        end = s.t + dt * (jnp.floor((adaptive.t - s.t) / dt + ROUNDING) + 1.0)
        tried = _try(stepper, model, adaptive, end, dt, accuracy)
        lengths = lengths.at[number].set(jnp.where(tried.accepted, tried.h, 0.0))
        return tried.adaptive, lengths, number + tried.accepted

    nothing = jnp.zeros(most, model.dtype), jnp.zeros((), jnp.int32)
    end, lengths, number = jax.lax.while_loop(before_end, attempt, (adaptive, *nothing))
    return lengths, number, end.has_failed | (end.t < last - ROUNDING * dt)


def interval_ends(length: Array, dt: float | Array, intervals: int) -> Array:
    """Number of steps of these lengths (most,) [s] up to the end of each of the intervals of dt [s]."""
    ends = jnp.searchsorted(jnp.cumsum(length), dt * (1.0 + jnp.arange(intervals)) * (1.0 - ROUNDING)) + 1
    return jnp.minimum(ends, len(length)).astype(jnp.int32)


def integrate_adaptively(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: float | Array,
    intervals: int,
    accuracy: float | Array,
    most: int,
    checkpoint: bool = False,
    warn: bool = True,
) -> tuple[State, Trajectory]:
    """Run `intervals` of dt [s] from s in steps that follow an accuracy: a pure function to `jit`, `grad`, `jacfwd` and
    `vmap` over model and s.

    The steps are found first, and the run repeats them. Derivatives exist in both modes, with the steps held constant:
    they are those of runs of which all take the same steps, as `dropper sensitivity` takes them.

    Args:
        stepper: from `make_stepper`; static, as are `intervals` and `most`.
        dt: time between saved states [s].
        accuracy: as `run.accuracy` of a scene.
        most: capacity for steps, for which reverse mode has memory. A run of more has failed (`first_bad`).
        checkpoint, warn: as of `integrate`.

    Returns:
        The last state, and the saved ones; their tensions are means over the interval before. `failed` and `first_bad`
        are those of the whole run.
    """
    meter = growth_meter(model, s) if warn else None
    dt = jnp.asarray(dt, model.dtype)
    accuracy = jnp.asarray(accuracy, model.dtype)
    given = jax.lax.stop_gradient((model, s, dt))
    length, _, failed = find_lengths(stepper, *given, intervals, accuracy, most)
    ends = interval_ends(length, dt, intervals)
    none = jnp.zeros(intervals, jnp.int32)
    found = Steps(length, ends, jnp.zeros(intervals, model.dtype), none, jnp.broadcast_to(failed, (intervals,)))
    return along_accepted_steps(stepper.plain, model, s, found, 1, checkpoint, meter, follows=True)


def adaptive_start(stepper: Stepper, model: Model, progress: Progress, record: Record | None = None) -> Adaptive:
    """The carry of a run that starts."""
    none = jnp.zeros((), jnp.int32)
    control = start_control(stepper, model, progress.state)
    return Adaptive(progress, control, none, none, jnp.zeros((), model.dtype), record)
