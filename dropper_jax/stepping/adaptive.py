"""Snap-adaptive steps: a step is rejected and repeated if a tension changes too much within it.

    roughness = max over links |T1 - T0| h / m,    m the mean mass of a link

T0 and T1 are the tensions of the previous and of this step, and the roughness is the speed that their change could give
to a link. On a snapping chain it gives the same standard deviation and peaks with half the steps of an estimate of the
position error (Zienkiewicz and Xie 1991). The next step is `0.85 (tolerance/roughness)^(1/2)` times this one, within
bounds. Steps end at the saved times, which are evenly spaced.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.stepping.control import Interval, advance_over
from dropper_jax.stepping.extremes import Extremes, Watch, no_extremes, with_step
from dropper_jax.stepping.integrate import Progress, Trajectory, begin, empty_rows, scan_steps


class Adaptive(NamedTuple):
    """State of a snap-adaptive run: progress in intervals, the next step [s], the number of rejected steps."""

    progress: Progress
    h: jax.Array
    refused: jax.Array

    @property
    def state(self) -> State:
        """State of the line at the end of the last interval."""
        return self.progress.state

    @property
    def steps_done(self) -> jax.Array:
        """Intervals done."""
        return self.progress.done

    @property
    def t(self) -> jax.Array:
        """Time reached [s]."""
        return self.progress.t

    @property
    def has_failed(self) -> jax.Array:
        """Whether a step failed."""
        return self.progress.has_failed


class Within(NamedTuple):
    """Tensions between two saved times: mean and mean square, (k, n) each; steps (k,)."""

    mean: jax.Array
    square: jax.Array
    steps: jax.Array


class _Interval(NamedTuple):
    """State of the loop over the steps of one interval."""

    adaptive: Adaptive
    within: Within
    residual: jax.Array
    retried: jax.Array
    bad: jax.Array
    extremes: Extremes | None


def advance_adaptively(
    stepper: Stepper,
    model: Model,
    adaptive: Adaptive,
    dt: jax.Array,
    tolerance: jax.Array,
    saves: int,
    count: jax.Array | None = None,
    watch: Watch | None = None,
) -> tuple[Adaptive, tuple[Trajectory, Within]]:
    """Advance by `saves` intervals of dt [s], in steps with a roughness of at most `tolerance` [m/s].

    Saved tensions are means over their interval; signals of `watch` have their extremes over all steps. With a `count`
    only this number of intervals is computed, and of `saves` rows the first are filled.
    """

    def save(adaptive: Adaptive, _: jax.Array | None) -> tuple[Adaptive, tuple[Trajectory, Within]]:
        s, none = adaptive.progress.state, jnp.zeros((), jnp.int32)
        end, nothing = s.t + dt, jnp.zeros_like(s.tension)
        within, extremes = Within(nothing, nothing, none), no_extremes(watch, model, s)
        start = _Interval(adaptive, within, jnp.zeros((), model.dtype), none, none, extremes)

        def before_end(done: _Interval) -> jax.Array:
            return done.adaptive.progress.state.t < end - 1e-9 * dt

        def attempt(done: _Interval) -> _Interval:
            (_, count, first_bad), wanted, refused = done.adaptive
            tried = _try(stepper, model, done.adaptive, end, dt, tolerance)
            first = jnp.where(tried.step.failed & tried.take & (first_bad < 0), count, first_bad)
            within, tension = done.within, tried.step.state.tension
            taken = _Interval(
                Adaptive(Progress(tried.step.state, count, first), wanted, refused),
                Within(
                    within.mean + tried.h / dt * tension,
                    within.square + tried.h / dt * tension**2,
                    within.steps + 1,
                ),
                jnp.maximum(done.residual, tried.step.row),
                done.retried + tried.step.retried,
                done.bad + tried.step.failed,
                with_step(done.extremes, watch, model, done.adaptive.state, tried.step.state),
            )
            after = jax.tree.map(lambda a, b: jnp.where(tried.take, a, b), taken, done)
            return after._replace(adaptive=after.adaptive._replace(h=tried.following, refused=refused + ~tried.take))

        done = jax.lax.while_loop(before_end, attempt, start)
        s = replace(done.adaptive.progress.state, t=end)
        progress = Progress(s, done.adaptive.progress.done + 1, done.adaptive.progress.first_bad)
        counts = done.residual, done.retried, done.bad, progress.first_bad
        row = Trajectory(s.r, s.v, done.within.mean, s.work, *counts, s.parted, s.own, done.extremes)
        return done.adaptive._replace(progress=progress), (row, done.within)

    rows = empty_rows(jax.eval_shape(save, adaptive, None)[1], saves)
    return scan_steps(save, adaptive, saves if count is None else count, rows)


class _Tried(NamedTuple):
    """A trial step and its length, whether it is accepted, the length of the next."""

    step: Interval
    h: jax.Array
    take: jax.Array
    following: jax.Array


def _try(
    stepper: Stepper, model: Model, adaptive: Adaptive, end: jax.Array, dt: jax.Array, tolerance: jax.Array
) -> _Tried:
    # minimum step as a fraction of the interval between saved times; such a step is accepted at any roughness
    shortest = 1.0 / 4096.0
    # roughness over tolerance assigned to a step that is not solved; the inverse is the minimum used
    most = 1e6
    (state, _, first_bad), wanted, _ = adaptive
    left = end - state.t
    h = left / jnp.ceil(left / wanted - 1e-9)
    taken = advance_over(stepper, model, state, h, first_bad < 0)
    rough = roughness(model, state, taken.state, h) / tolerance
    rough = jnp.where(taken.failed | ~jnp.isfinite(rough), most, rough)
    # a failed run continues to its end with any roughness
    take = (rough <= 1.0) | (h <= 1.01 * shortest * dt) | (first_bad >= 0)
    factor = jnp.clip(0.85 / jnp.sqrt(jnp.maximum(rough, 1.0 / most)), 0.25, 1.6)
    return _Tried(taken, h, take, jnp.clip(h * factor, shortest * dt, dt))


def adaptive_step_lengths(
    stepper: Stepper, model: Model, s: State, dt: jax.Array, intervals: int, tolerance: jax.Array, most: int = 100_000
) -> tuple[jax.Array, jax.Array]:
    """Lengths (most,) [s] of the snap-adaptive steps of `intervals` of dt [s] from s, and their number.

    A run along these steps, `integrate(stepper, model, s, lengths[:number], number)`, has derivatives in both modes
    with the steps held constant. Steps after the first `most` are left out.
    """
    adaptive = adaptive_start(begin(stepper, model, s), dt)
    last = adaptive.progress.state.t + intervals * dt

    def before_end(carry: tuple[Adaptive, jax.Array, jax.Array]) -> jax.Array:
        return (carry[0].progress.state.t < last - 1e-9 * dt) & (carry[2] < most)

    def attempt(carry: tuple[Adaptive, jax.Array, jax.Array]) -> tuple[Adaptive, jax.Array, jax.Array]:
        adaptive, lengths, number = carry
        end = s.t + dt * (jnp.floor((adaptive.progress.state.t - s.t) / dt + 1e-9) + 1.0)
        tried = _try(stepper, model, adaptive, end, dt, tolerance)
        state = jax.tree.map(lambda a, b: jnp.where(tried.take, a, b), tried.step.state, adaptive.progress.state)
        after = Adaptive(adaptive.progress._replace(state=state), tried.following, adaptive.refused + ~tried.take)
        return after, lengths.at[number].set(jnp.where(tried.take, tried.h, 0.0)), number + tried.take

    nothing = jnp.zeros(most, model.dtype), jnp.zeros((), jnp.int32)
    _, lengths, number = jax.lax.while_loop(before_end, attempt, (adaptive, *nothing))
    return lengths, number


def adaptive_start(progress: Progress, dt: jax.Array) -> Adaptive:
    """The carry of a run whose first step is 1/16 of the interval."""
    return Adaptive(progress, dt / 16.0, jnp.zeros((), jnp.int32))


def roughness(model: Model, before: State, after: State, h: jax.Array) -> jax.Array:
    """Speed [m/s] that the change of a tension within a step could give to a link."""
    return jnp.max(jnp.abs(after.tension - before.tension)) * h / jnp.mean(model.line.mass)
