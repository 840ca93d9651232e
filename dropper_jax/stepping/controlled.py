"""Runs of error-controlled schemes (`integrators.projected`): step by step, with saved times between the steps.

The next step follows from the errors of this step and of the previous one by PI control (`pi_control`), within bounds.
States at saved times are those of
the polynomial through positions, velocities and accelerations at the ends of the last steps. Steps end at times at
which an effect is not smooth (`Model.corners`). The jump is applied there, and the stepping starts again.

The error is not differentiated: derivatives of a run are those with the steps held constant. Forward mode
differentiates the run itself; for reverse mode `controlled_steps` finds the steps, and `integrate_along` repeats them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.base.constants import GRAVITY
from dropper_jax.integrators.projected import (
    Knot,
    ProjectedRungeKutta,
    at_knot,
    moving,
    on_links,
    split_row,
    state_between,
    time_just_after,
)
from dropper_jax.model import Model, State, state
from dropper_jax.residual import Stepper
from dropper_jax.stepping.extremes import Extremes, Watch, no_extremes, with_step
from dropper_jax.stepping.integrate import Trajectory, begin, empty_rows
from dropper_jax.stepping.pi_control import step_ratio

#: Ratios of a step to the previous one: after an accepted one, and after a rejected one.
SLOWER, FASTER = 0.2, 6.0
REFUSED, REPEATED = 0.1, 0.9
#: Bounds of the relative error of a step in the choice of the next step; the upper one is used for NaN.
LEAST, MOST = 1e-4, 1e10


class Controlled(NamedTuple):
    """State of an error-controlled run.

    Attributes:
        knots: ends of the last steps, the newest last.
        known: steps since the start or the last corner ().
        h: the next step [s].
        error: that of the last accepted step, relative to the tolerance.
        taken, refused: accepted and rejected steps so far.
        saved: saved times so far.
        origin: time [s] from which saved times count.
        landed: whether the last step ended at a corner, with its jump still to be applied.
        bad: 0, or 1 if the shortest resolvable step is rejected, 2 if it is not finite.
    """

    knots: tuple[Knot, ...]
    known: jax.Array
    h: jax.Array
    error: jax.Array
    taken: jax.Array
    refused: jax.Array
    saved: jax.Array
    origin: jax.Array
    landed: jax.Array
    bad: jax.Array

    @property
    def now(self) -> Knot:
        return self.knots[-1]

    @property
    def steps_done(self) -> jax.Array:
        """Saved times so far."""
        return self.saved

    @property
    def t(self) -> jax.Array:
        """Time reached [s]."""
        return self.now.t

    @property
    def has_failed(self) -> jax.Array:
        """Whether no step can be taken."""
        return self.bad != 0


class Steps(NamedTuple):
    """Steps of a run: lengths (most,) [s], whether they end at a corner (most,), and their number."""

    length: jax.Array
    corner: jax.Array
    number: jax.Array


def start_controlled(stepper: Stepper, model: Model, s: State, tolerance: jax.Array) -> Controlled:
    """The carry of a run that starts at s."""
    scheme = stepper.integrator
    now = scheme.start(model, begin(stepper, model, s).state, stepper.track_work)
    # dummy times of unused knots, which avoid a division by zero
    knots = tuple(now._replace(t=now.t - i) for i in reversed(range(scheme.knots)))
    none, one = jnp.zeros((), jnp.int32), jnp.ones((), model.dtype)
    first = _first_step(scheme, model, now, tolerance)
    return Controlled(knots, none, first, one, none, none, none, now.t, jnp.zeros((), bool), none)


def advance_controlled(
    stepper: Stepper,
    model: Model,
    carry: Controlled,
    dt: jax.Array,
    tolerance: jax.Array,
    saves: int,
    count: jax.Array | None = None,
    every: int = 1,
    watch: Watch | None = None,
) -> tuple[Controlled, tuple[Trajectory, jax.Array]]:
    """Advance by `saves` saved times, dt [s] apart; returns the trajectory and the steps (k,) [s] that contain these
    times.

    After a failure the states are invalid: `Trajectory.first_bad` is the number of the first invalid saved time. With a
    `count` only this number of times is computed, and of `saves` rows the first are filled. Signals of `watch` have
    their extremes over `every` times from one saved time to the next.
    """
    first = carry.saved
    last = first + (saves if count is None else count)
    blank = no_extremes(watch, model, at_knot(state(model, jnp.zeros((model.free_nodes, 3), model.dtype)), carry.now))
    row = carry.now.y, carry.now.t, blank
    start = _Rows(carry, jnp.zeros((), jnp.int32), blank, empty_rows(row, saves))

    def time(now: _Rows) -> jax.Array:
        return now.carry.origin + (now.carry.saved + (now.part + 1).astype(dt.dtype) / every) * dt

    def due(now: _Rows) -> jax.Array:
        carry = now.carry
        return (carry.saved < last) & (time(now) <= time_just_after(carry.now.t)) & (carry.bad == 0)

    def write(now: _Rows) -> _Rows:
        carry, t = now.carry, time(now)
        y = state_between(model, carry.knots, carry.known, t)
        extremes = now.extremes
        if watch is not None:
            here = _state_at(model, y, t)
            extremes = with_step(extremes, watch, model, here, here)
        row = y, carry.now.t - carry.knots[-2].t, extremes
        put = partial(jax.lax.dynamic_update_index_in_dim, index=carry.saved - first, axis=0)  # `.at[].set` scatters
        rows = jax.tree.map(lambda a, x: put(a, x.astype(a.dtype)), now.rows, row)
        full = now.part + 1 == every  # before that the row is written again
        extremes = jax.tree.map(partial(jnp.where, full), blank, extremes)
        return _Rows(carry._replace(saved=carry.saved + full), jnp.where(full, 0, now.part + 1), extremes, rows)

    def go(now: _Rows) -> jax.Array:
        return (now.carry.saved < last) & (now.carry.bad == 0)

    def go_on(now: _Rows) -> _Rows:
        return now._replace(carry=_attempt(stepper, model, now.carry, tolerance))

    def one(now: _Rows) -> _Rows:
        return jax.lax.cond(due(now), write, go_on, now)

    done = jax.lax.while_loop(go, one, start)
    carry, (y, h, extremes) = done.carry, done.rows
    t = carry.origin + (first + 1 + jnp.arange(saves)) * dt
    return carry, (_trajectory(model, first, carry.saved, carry.bad, y, t)._replace(extremes=extremes), h)


class _Rows(NamedTuple):
    """State of the loop over steps and times: times since the last saved one, their extremes, and the rows."""

    carry: Controlled
    part: jax.Array
    extremes: Extremes | None
    rows: tuple[jax.Array, jax.Array, Extremes | None]


def _state_at(model: Model, y: jax.Array, t: jax.Array) -> State:
    """The state of a row (...) at time t [s], with rigid links of their lengths and the tensions of this motion."""
    r, v, _ = split_row(model, y)
    r, v = on_links(model, r, v, time_just_after(t, -1.0))
    tension = moving(model, r, v, time_just_after(t, -1.0), False).tension
    return replace(state(model, r, tension=tension, t=t), v=v)


def _trajectory(
    model: Model, first: jax.Array, saved: jax.Array, bad: jax.Array, y: jax.Array, t: jax.Array
) -> Trajectory:
    """Rows y (k, ...) at times t (k,) as a trajectory, projected to the lengths of rigid links after the
    interpolation."""

    def to_links(row: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, ...]:
        s = _state_at(model, *row)
        return s.r, s.v, s.tension

    *_, work = split_row(model, y)
    # row by row: a loop becomes one kernel, all rows at once would need some hundred
    r, v, tension = jax.lax.map(to_links, (y, t))
    lost, none = first + jnp.arange(len(t), dtype=jnp.int32) >= saved, jnp.zeros(len(t), jnp.int32)
    residual = jnp.where(lost, jnp.where(bad == 2, jnp.nan, jnp.inf), 0.0).astype(model.dtype)
    failed, first_bad = lost.astype(jnp.int32), jnp.where(lost, saved, -1)
    return Trajectory(r, v, tension, work, residual, none, failed, first_bad, own={})


def _attempt(stepper: Stepper, model: Model, carry: Controlled, tolerance: jax.Array) -> Controlled:
    """The carry after a trial step."""
    scheme: ProjectedRungeKutta = stepper.integrator
    carry = _turn_corner(stepper, model, carry, tolerance)
    now, q = carry.now, scheme.order
    h, landing = _to_corner(model, now.t, carry.h)
    after, errors = scheme.attempt(model, now, h, stepper.track_work)
    if landing is not None:
        after = after._replace(t=jnp.where(landing, _next_corner(model, now.t), after.t))
    e = scheme.estimate(errors, jax.lax.stop_gradient(split_row(model, now.y)[1]), tolerance)
    finite = jnp.isfinite(e) & jnp.all(jnp.isfinite(jax.lax.stop_gradient(after.y)))
    e = jax.lax.stop_gradient(jnp.where(finite, jnp.clip(e, 1e-10, MOST), MOST))
    good = e <= 1.0
    least, most = jnp.where(good, SLOWER, REFUSED), jnp.where(good, FASTER, REPEATED)
    ratio = jnp.clip(step_ratio(e, carry.error, q, good), least, most)
    following = jnp.minimum(jax.lax.stop_gradient(h) * ratio, _longest(model))
    knots = jax.tree.map(partial(jnp.where, good), (*carry.knots[1:], after), carry.knots)
    shortest = jax.lax.stop_gradient(time_just_after(jnp.abs(now.t), 64.0) - jnp.abs(now.t))
    lost = ~good & ~(h > shortest)  # a NaN step is rejected as well
    return carry._replace(
        knots=knots,
        known=carry.known + good,
        h=following,
        error=jnp.where(good, jnp.maximum(e, LEAST), carry.error),
        taken=carry.taken + good,
        refused=carry.refused + ~good,
        landed=carry.landed if landing is None else good & landing,
        bad=jnp.where(lost, jnp.where(finite, 1, 2), carry.bad).astype(jnp.int32),
    )


def _turn_corner(stepper: Stepper, model: Model, carry: Controlled, tolerance: jax.Array) -> Controlled:
    """The carry, after a step that ended at a corner with its jump applied."""
    if model.corners is None:
        return carry
    scheme: ProjectedRungeKutta = stepper.integrator

    def turn(carry: Controlled) -> Controlled:
        now = scheme.after_jump(model, carry.now, stepper.track_work)
        return carry._replace(
            knots=(*carry.knots[:-1], now),
            known=jnp.zeros_like(carry.known),
            h=jnp.minimum(carry.h, _first_step(scheme, model, now, tolerance)),
            error=jnp.ones_like(carry.error),
            landed=jnp.zeros_like(carry.landed),
        )

    return jax.lax.cond(carry.landed, turn, lambda carry: carry, carry)


def _first_step(scheme: ProjectedRungeKutta, model: Model, now: Knot, tolerance: jax.Array) -> jax.Array:
    a = now.rate[3 * model.free_nodes : 6 * model.free_nodes]
    size = jnp.sqrt(jnp.min(model.line.length) / jnp.maximum(jnp.max(jnp.abs(a)), GRAVITY))
    # first step over `(L/a)^(1/2) tolerance^(1/q)`: short enough for interpolation with two knots
    return jax.lax.stop_gradient(0.1 * tolerance ** (1.0 / scheme.order) * size)


def _longest(model: Model) -> jax.Array:
    """Maximum step [s]: the time in which the line would fall its length."""
    return jax.lax.stop_gradient(jnp.sqrt(jnp.sum(model.line.length) / GRAVITY))


def _next_corner(model: Model, t: jax.Array) -> jax.Array:
    """The next time at which an effect is not smooth; infinite without any."""
    corners = model.corners
    return jnp.min(jnp.where(corners > time_just_after(t, 2.0), corners, jnp.inf))


def _to_corner(model: Model, t: jax.Array, h: jax.Array) -> tuple[jax.Array, jax.Array | None]:
    """The step, shortened to end at the next corner or well before it, and whether it ends there."""
    if model.corners is None:
        return h, None
    gap = _next_corner(model, t) - t
    landing = gap <= 1.01 * h
    return jnp.where(landing, gap, jnp.where(gap < 2.0 * h, 0.5 * jax.lax.stop_gradient(gap), h)), landing


def controlled_steps(
    stepper: Stepper, model: Model, s: State, duration: jax.Array, tolerance: jax.Array, most: int = 10_000
) -> Steps:
    """The steps of a run over at least `duration` [s] from s; steps after the first `most` are left out."""
    tolerance = jnp.asarray(tolerance, model.dtype)
    carry = jax.lax.stop_gradient(start_controlled(stepper, model, s, tolerance))
    last = carry.now.t + duration

    def go(both: tuple[Controlled, Steps]) -> jax.Array:
        carry, steps = both
        return (time_just_after(carry.now.t) < last) & (steps.number < most) & (carry.bad == 0)

    def one(both: tuple[Controlled, Steps]) -> tuple[Controlled, Steps]:
        carry, steps = both
        after = _attempt(stepper, model, carry, tolerance)
        put = partial(jax.lax.dynamic_update_index_in_dim, index=steps.number, axis=0)
        lengths = put(steps.length, jnp.where(after.taken > carry.taken, after.now.t - carry.now.t, 0.0))
        return after, Steps(lengths, put(steps.corner, after.landed), after.taken)

    steps = Steps(jnp.zeros(most, model.dtype), jnp.zeros(most, bool), carry.taken)
    return jax.lax.stop_gradient(jax.lax.while_loop(go, one, (carry, steps))[1])


def integrate_along(
    stepper: Stepper, model: Model, s: State, steps: Steps, dt: float | jax.Array, saves: int
) -> tuple[State, Trajectory]:
    """The run along `steps` from s, its states at `saves` times dt [s] apart, and the state at its end.

    A pure function with derivatives by model and s in both modes, with these steps held constant. Reverse mode stores
    the end of every step and repeats the step in the backward pass.
    """
    scheme: ProjectedRungeKutta = stepper.integrator
    track = stepper.track_work
    first = scheme.start(model, begin(stepper, model, s).state, track)

    @jax.checkpoint
    def take(now: Knot, step: tuple[jax.Array, jax.Array]) -> tuple[Knot, Knot]:
        h, corner = step
        if model.corners is not None:
            # the step ends at the corner also if the time of the corner depends on a parameter
            h = jnp.where(corner, _next_corner(model, now.t) - now.t, h)
        after, _ = scheme.attempt(model, now, h, track)
        if model.corners is None:
            return after, after
        after = after._replace(t=jnp.where(corner, _next_corner(model, now.t), after.t))
        return jax.lax.cond(corner, lambda k: scheme.after_jump(model, k, track), lambda k: k, after), after

    def one(
        carry: tuple[Knot, jax.Array], step: tuple[jax.Array, jax.Array]
    ) -> tuple[Any, tuple[Knot, Knot, jax.Array]]:
        now, known = carry
        onward, ended = jax.lax.cond(step[0] > 0.0, take, lambda now, _: (now, now), now, step)
        known = known + 1
        return (onward, jnp.where(step[1], 0, known)), (now, ended, known)

    (last, _), (starts, ended, known) = jax.lax.scan(
        one, (first, jnp.zeros((), jnp.int32)), (steps.length, steps.corner)
    )
    t = first.t + dt * (1 + jnp.arange(saves))

    def at(t: jax.Array) -> jax.Array:
        i = jnp.minimum(jnp.searchsorted(jax.lax.stop_gradient(time_just_after(ended.t)), t), steps.number - 1)
        knots = jax.tree.map(itemgetter(i), (starts, ended))
        if scheme.knots == 3:
            earlier = jax.tree.map(itemgetter(jnp.maximum(i - 1, 0)), starts)
            earlier = earlier._replace(t=jnp.where(i > 0, earlier.t, knots[0].t - 1.0))
            knots = (earlier, *knots)
        return state_between(model, knots, known[i], t)

    y = jax.vmap(at)(t)
    none = jnp.zeros((), jnp.int32)
    return at_knot(s, last), _trajectory(model, none, jnp.int32(saves), none, y, t)
