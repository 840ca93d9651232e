"""Many steps as one compiled program, the functional core under `simulate`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.one_kernel import forbids_callbacks
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper, step
from dropper_jax.stepping.adaptive import find_lengths, follow_and_save, interval_ends, midstep_tension
from dropper_jax.stepping.equal_steps import advance_and_save
from dropper_jax.stepping.extremes import Watch
from dropper_jax.stepping.growth_watch import SEGMENTS, start_meter, watch
from dropper_jax.stepping.halving import attempt, begin_interval
from dropper_jax.stepping.progress import Progress, Trajectory, begin
from dropper_jax.stepping.step_change import with_step_changed

Carry = TypeVar("Carry")
Rows = TypeVar("Rows")
#: The state of a loop between two of its rounds.
Loop = tuple[Any, ...]
#: Capacity for the steps of a run that follows an accuracy.
MOST_CHOSEN = 100_000


def scan_steps(
    advance: Callable[[Carry, Any], tuple[Carry, Rows]], carry: Carry, count: Array | np.integer | int, rows: Rows
) -> tuple[Carry, Rows]:
    """Call `advance(carry, number)` `count` times; its results replace the first of the `rows` (capacity, ...).

    `count` may be traced, which `scan` does not allow: one program serves runs of any length up to the capacity.
    """

    def fill(i: Array, both: tuple[Carry, Rows]) -> tuple[Carry, Rows]:
        carry, row = advance(both[0], i)

        def set_row(rows: Array, row: Array) -> Array:
            return jax.lax.dynamic_update_index_in_dim(rows, row.astype(rows.dtype), i, axis=0)

        return carry, jax.tree.map(set_row, both[1], row)

    return jax.lax.fori_loop(0, count, fill, (carry, rows))


def empty_rows(row: Rows, capacity: int) -> Rows:
    """Rows (capacity, ...) of zeros like this one."""
    return jax.tree.map(lambda a: jnp.zeros((capacity, *jnp.shape(a)), a.dtype), row)


def empty_trajectory(progress: Progress, capacity: int) -> Trajectory:
    """A trajectory with `capacity` rows of zeros, of equal steps from states like this one."""
    s = progress.state
    number = jnp.zeros((), jnp.int32)
    counts = jnp.zeros((), s.r.dtype), number, number, number
    return empty_rows(Trajectory(s.r, s.v, s.tension, s.work, *counts, s.parted, s.own), capacity)


def advance(
    stepper: Stepper,
    model: Model,
    progress: Progress,
    dt: Array,
    saves: int,
    save_every: int = 1,
    accuracy: Array | None = None,
    count: Array | np.integer | None = None,
    watch: Watch | None = None,
) -> tuple[Progress, Trajectory]:
    """Advance to `saves` saved times, each after `save_every` steps of dt [s].

    With an accuracy dt is the interval between saved times, and the steps follow the accuracy. With a `count` only this
    number of saves is computed, and of `saves` rows the first are filled: one program runs chunks of any length, which
    allows progress reports and interruption.
    """

    def save(carry: Progress, _: Array | None) -> tuple[Progress, Trajectory]:
        if accuracy is None:
            return advance_and_save(stepper, model, carry, dt, save_every, watch)
        return follow_and_save(stepper, model, carry, dt, accuracy, watch)

    if count is None:
        return jax.lax.scan(save, progress, None, length=saves)
    traced_once = jax.jit(save, inline=True)  # for the shapes of its rows, and for the loop
    return scan_steps(traced_once, progress, count, empty_rows(jax.eval_shape(traced_once, progress, None)[1], saves))


class Steps(NamedTuple):
    """Steps that a run of k intervals accepts.

    Attributes:
        length: lengths (most,) [s], 0 after the last one.
        ends: number of steps up to the end of each interval (k,).
        residual, retried, failed: of each interval (k,), see `Trajectory`; of steps that follow an accuracy `failed` is
            that of the whole run.
    """

    length: Array | np.ndarray
    ends: Array | np.ndarray
    residual: Array | np.ndarray
    retried: Array | np.ndarray
    failed: Array | np.ndarray


def step_lengths(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: float | Array,
    intervals: int,
    most: int | None = None,
    accuracy: float | Array | None = None,
) -> Steps:
    """The steps of a run over `intervals` of dt [s], scalar or (intervals,), from s; not differentiated.

    A run along them, `integrate(stepper, model, s, steps.length[:number], number)` with `number = int(steps.ends[-1])`,
    has derivatives in both modes with the steps held constant.

    Args:
        most: capacity for steps; default: half more than the intervals, and 64; `MOST_CHOSEN` with an accuracy. What
            exceeds it counts as failed.
        accuracy: that the steps follow, as `run.accuracy` of a scene, with one dt for all intervals; by default a step
            covers an interval, or parts of it where it does not converge.
    """
    if most is None and accuracy is None:
        most = intervals + max(64, intervals // 2)
    elif most is None:
        most = MOST_CHOSEN
    return _step_lengths(stepper, model, s, dt, intervals, most, accuracy)


@partial(jax.jit, static_argnames=("stepper", "intervals", "most"), inline=True)
def _step_lengths(
    stepper: Stepper, model: Model, s: State, dt: Array, intervals: int, most: int, accuracy: Array | None
) -> Steps:
    model, s, dt = jax.lax.stop_gradient((model, s, jnp.asarray(dt, model.dtype)))
    if accuracy is None:
        return _halved_steps(stepper, model, s, dt, intervals, most)
    accuracy = jnp.asarray(accuracy, model.dtype)
    length, _, failed = find_lengths(stepper, model, s, dt, intervals, accuracy, most)
    none = jnp.zeros(intervals, jnp.int32)
    of_run = jnp.broadcast_to(failed, (intervals,))
    return Steps(length, interval_ends(length, dt, intervals), jnp.zeros(intervals, model.dtype), none, of_run)


def _halved_steps(stepper: Stepper, model: Model, s: State, dt: Array, intervals: int, most: int) -> Steps:
    """One step for each interval, or halves of it where it does not converge."""

    def one(carry: Loop, sizes: tuple[Array, Array | None]) -> tuple[Loop, tuple[Array, ...]]:
        s, number, lengths, alive = carry
        size, last = sizes
        if last is not None:
            s, _ = with_step_changed(stepper, model, s, last, size)

        def try_one(now: Loop) -> Loop:
            interval, number, lengths = now
            interval, part = attempt(stepper, model, interval, size, alive)
            lengths = jax.lax.dynamic_update_index_in_dim(lengths, part * size, number, axis=0)
            return interval, number + (part > 0.0), lengths

        start = begin_interval(s), number, lengths
        end, number, lengths = jax.lax.while_loop(lambda now: now[0].unfinished, try_one, start)
        full = number > most
        residual = jnp.where(full, jnp.inf, end.row).astype(model.dtype)
        failed = end.failed | full
        return (end.state, number, lengths, alive & ~failed), (number, residual, end.retried, failed)

    first = begin(stepper, model, s).state
    start = first, jnp.zeros((), jnp.int32), jnp.zeros(most + 1, model.dtype), jnp.ones((), bool)
    sizes = jnp.broadcast_to(dt, intervals), _intervals_before(stepper, dt)
    (_, _, lengths, _), found = jax.lax.scan(one, jax.tree.map(jnp.asarray, start), sizes)
    return Steps(lengths[:most], *found)


def _intervals_before(stepper: Stepper, dt: Array) -> Array | None:
    """The interval before each of several (intervals,) [s], 0 before the first; None if all are equal, or if the scheme
    has nothing to change between steps of different length."""
    if dt.ndim and stepper.integrator.local_error is not None:
        return jnp.append(0.0, dt[:-1])
    return None


def _of_first_steps(found: Steps, values: Array) -> Array:
    """Values (most,) of steps: those of the intervals (intervals,) at the first step of each, 0 at others."""
    number = jnp.arange(len(found.length))
    # a search, because a scatter prevents one kernel
    interval = jnp.searchsorted(found.ends, number, side="right")
    first = jnp.append(0, found.ends[:-1])
    return jnp.where(number == first[interval], values[interval], 0.0)


def integrate(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: float | Array,
    steps: int,
    save_every: int = 1,
    checkpoint: bool = False,
    warn: bool = True,
    accuracy: float | Array | None = None,
    most: int | None = None,
) -> tuple[State, Trajectory]:
    """Run `steps` steps of `dt` from `s`: a pure function to `jit`, `grad`, `jacfwd` and `vmap` over model, s and dt.

    Called without `jit` it is compiled by the first call, and so is its gradient; later calls take other values only.

    With an accuracy, or with `stepper.halvings`, the accepted steps are found first (`step_lengths`), and the run
    repeats them. Derivatives exist in both modes, with the steps held constant: they are those of runs of which all
    take the same steps, as `dropper sensitivity` takes them. `stepper.plain` takes equal steps as they are given, in
    half of the time; one that does not converge is reported in the trajectory (`failed`, `first_bad`).

    Args:
        stepper: from `make_stepper`; static.
        dt: step [s], or one for each step (steps,); with an accuracy the time between saved states.
        steps: a multiple of `save_every`; with an accuracy the number of saved states.
        checkpoint: for long reverse-mode runs: store states at about sqrt(steps) times only and repeat the steps from
            there in the backward pass (one more forward run, memory ~ sqrt(steps)). Not needed in forward mode.
        warn: whether a derivative in reverse mode that has grown by more than e^10 gives a `RuntimeWarning`, once. It
            takes a call of Python per gradient, so JAX does not cache the compiled gradient between processes, and
            is left out of what `dj.one_kernel` compiles.
        accuracy: that the steps follow, as `run.accuracy` of a scene. The tensions saved are then means over the
            interval before, and `failed` and `first_bad` are those of the whole run.
        most: capacity for these steps, for which reverse mode has memory; see `step_lengths`. A run of more has failed.

    Returns:
        The last state, and the saved ones.

    Raises:
        ValueError: steps, `save_every` or `most` that are not whole numbers >= 1, `save_every` that does not divide
            the steps, or is given together with an accuracy, another shape of dt.
    """
    for name, number in (("steps", steps), ("save_every", save_every), ("most", 1 if most is None else most)):
        if not isinstance(number, int | np.integer) or number < 1:
            raise ValueError(f"{name}: {number!r} is not a number of steps; allowed: a whole number >= 1")
    if steps % save_every:
        raise ValueError(f"steps: {steps} is not a multiple of save_every = {save_every}")
    if accuracy is not None and save_every != 1:
        raise ValueError(f"save_every: {save_every} counts equal steps; allowed: 1 with an accuracy. Use a larger dt")
    dt = jnp.asarray(dt, model.dtype)
    shapes = [()]
    if accuracy is None:
        shapes.append((steps,))
    if dt.shape not in shapes:
        raise ValueError(f"dt: has the shape {dt.shape}; allowed: {' or '.join(map(str, shapes))}")
    return _integrate(stepper, model, s, dt, steps, save_every, checkpoint, warn, accuracy, most)


# not inlined: JAX then keeps the program of a gradient too, 0.05 in place of 8 s for the second one
@partial(jax.jit, static_argnames=("stepper", "steps", "save_every", "checkpoint", "warn", "most"))
def _integrate(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: Array,
    steps: int,
    save_every: int,
    checkpoint: bool,
    warn: bool,
    accuracy: Array | None,
    most: int | None,
) -> tuple[State, Trajectory]:
    meter = growth_meter(model, s, dt) if warn else None
    follows = accuracy is not None
    if follows or (stepper.halvings and stepper.integrator.implicit):
        found = step_lengths(stepper, model, s, dt, steps, most, accuracy)
        before = _intervals_before(stepper, jax.lax.stop_gradient(dt))
        if before is not None:
            before = _of_first_steps(found, before)
        return along_accepted_steps(stepper.plain, model, s, found, save_every, checkpoint, meter, follows, before)
    return _given_steps(stepper.plain, model, s, dt, steps, save_every, checkpoint, meter)


def _given_steps(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: Array,
    steps: int,
    save_every: int,
    checkpoint: bool,
    meter: Array | None,
) -> tuple[State, Trajectory]:
    """The run in steps as they are given."""
    saves = steps // save_every
    sizes = jnp.broadcast_to(dt, steps).reshape(saves, save_every)
    before = _intervals_before(stepper, dt)
    if before is not None:
        before = before.reshape(saves, save_every)
    rows = sizes, before, _measured(jnp.arange(1, saves + 1), saves)

    def save(carry: Loop, row: tuple[Any, ...]) -> tuple[Loop, Trajectory]:
        progress, meter = carry
        sizes, before, measured = row
        progress, saved = advance_and_save(stepper, model, progress, sizes, save_every, before=before)
        s, meter = _watch_growth(progress.state, meter, measured)
        return (progress._replace(state=s), meter), saved

    (progress, _), trajectory = _scan(save, (begin(stepper, model, s), meter), rows, checkpoint)
    return progress.state, trajectory


def growth_meter(*differentiated: Any) -> Array | None:
    """A meter of the growth of derivatives by these trees (see `growth_watch`); None in what may not call Python."""
    if forbids_callbacks():
        return None
    floats = [x for x in jax.tree.leaves(differentiated) if jnp.issubdtype(jnp.result_type(x), jnp.inexact)]
    return start_meter([jnp.asarray(x) for x in floats])


def _measured(number: Array, last: Array | int) -> Array:
    """After which of the numbers 1..last the growth of derivatives is measured: the last and, evenly spaced, at least
    `SEGMENTS - 1` others; all of few."""
    return (last - number) % jnp.maximum(last // SEGMENTS, 1) == 0


def _watch_growth(s: State, meter: Array | None, measured: Array) -> tuple[State, Array | None]:
    """The state and the meter (see `growth_watch`), unchanged."""
    if meter is None:
        return s, None
    r, meter = watch(s.r, meter, measured)
    return replace(s, r=r), meter


def along_accepted_steps(
    stepper: Stepper,
    model: Model,
    s: State,
    found: Steps,
    save_every: int,
    checkpoint: bool,
    meter: Array | None,
    follows: bool = False,
    before: Array | None = None,
) -> tuple[State, Trajectory]:
    """The run along known steps.

    Args:
        follows: whether the steps follow an accuracy: one that differs from that before starts with rates that suit it
            (`step_change`), and tensions are means over the interval.
        before: of steps that do not, the step before those (most,) [s] that start so, 0 of others; None if none does.
    """

    def take(carry: Loop, row: tuple[Array, Array | None, Array]) -> tuple[Loop, State]:
        s, meter = carry
        h, before, measured = row

        def advance_by_one(s: State) -> State:
            if before is not None:
                s, _ = with_step_changed(stepper, model, s, before, h)
            return step(stepper, model, s, h)[0]

        # zero after the last step; a length that is not a number makes a state of such numbers
        s = jax.lax.cond(h != 0.0, advance_by_one, lambda s: s, s)
        s, meter = _watch_growth(s, meter, measured)
        return (s, meter), s

    first = jax.tree.map(jnp.asarray, begin(stepper, model, s).state)
    if follows:
        before = jnp.append(0.0, found.length[:-1])
    rows = found.length, before, _measured(jnp.arange(1, len(found.length) + 1), found.ends[-1])
    (last, _), states = _scan(take, (first, meter), rows, checkpoint)
    trajectory = _saved_rows(found, states, save_every)
    if follows:
        before_each = jnp.concatenate([first.tension[None], states.tension[:-1]])
        means = _interval_means(found, midstep_tension(stepper, before_each, states.tension))
        trajectory = trajectory._replace(tension=means)
    return last, trajectory


def _saved_rows(found: Steps, states: State, save_every: int) -> Trajectory:
    """The rows of a run along known steps, of which `states` are the states after each (most, ...)."""
    at = jax.tree.map(lambda a: a[found.ends[save_every - 1 :: save_every] - 1], states)
    intervals = len(found.failed)
    number = jnp.where(found.failed, jnp.arange(intervals, dtype=jnp.int32), intervals)
    first_bad = jax.lax.associative_scan(jnp.minimum, number)[save_every - 1 :: save_every]
    return Trajectory(
        r=at.r,
        v=at.v,
        tension=at.tension,
        work=at.work,
        residual=jnp.max(found.residual.reshape(-1, save_every), axis=1),
        retried=jnp.sum(found.retried.reshape(-1, save_every), axis=1, dtype=jnp.int32),
        failed=jnp.sum(found.failed.reshape(-1, save_every), axis=1, dtype=jnp.int32),
        first_bad=jnp.where(first_bad < intervals, first_bad, -1),
        parted=at.parted,
        own=at.own,
    )


def _interval_means(found: Steps, tension: Array) -> Array:
    """Means (k, n) over the intervals of the tensions (steps, n) of steps."""

    def over_intervals(steps: Array | np.ndarray) -> Array:
        to_end = jnp.cumsum(steps, axis=0)[found.ends - 1]
        return jnp.diff(to_end, axis=0, prepend=jnp.zeros_like(to_end[:1]))

    length = found.length[:, None]
    return over_intervals(length * tension) / over_intervals(length)


def _scan(
    f: Callable[[Carry, Any], tuple[Carry, Rows]],
    start: Carry,
    rows: tuple[Array | np.ndarray | None, ...],
    checkpoint: bool,
) -> tuple[Carry, Rows]:
    """`jax.lax.scan`, with `checkpoint` in about sqrt(n) pieces that reverse mode repeats."""
    count = len(jax.tree.leaves(rows)[0])
    if not checkpoint or count < 4:
        return jax.lax.scan(f, start, rows)
    per = math.isqrt(count)
    whole = count // per * per

    @jax.checkpoint
    def piece(carry: Carry, rows: tuple[Array | np.ndarray | None, ...]) -> tuple[Carry, Rows]:
        return jax.lax.scan(f, carry, rows)

    pieces = jax.tree.map(lambda a: a[:whole].reshape(-1, per, *a.shape[1:]), rows)
    carry, found = jax.lax.scan(piece, start, pieces)
    found = jax.tree.map(lambda a: a.reshape(whole, *a.shape[2:]), found)
    if whole < count:
        carry, rest = jax.lax.scan(f, carry, jax.tree.map(lambda a: a[whole:], rows))
        found = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), found, rest)
    return carry, found
