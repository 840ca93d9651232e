"""Equal steps, or known ones, from one saved time to the next."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.model import Model
from dropper_jax.residual import Stepper
from dropper_jax.stepping.extremes import Extremes, Watch, no_extremes, with_step
from dropper_jax.stepping.halving import Interval, advance_over
from dropper_jax.stepping.progress import Progress, Trajectory
from dropper_jax.stepping.step_change import with_step_changed


def next_progress(stepper: Stepper, model: Model, progress: Progress, dt: Array) -> tuple[Progress, Interval]:
    """The progress after one step of dt [s], and how it was taken."""
    taken = advance_over(stepper, model, progress.state, dt, progress.first_bad < 0)
    first_bad = jnp.where(taken.failed & (progress.first_bad < 0), progress.done, progress.first_bad)
    return progress._replace(state=taken.state, done=progress.done + 1, first_bad=first_bad), taken


def advance_and_save(
    stepper: Stepper,
    model: Model,
    carry: Progress,
    dt: Array,
    save_every: int = 1,
    watch: Watch | None = None,
    before: Array | None = None,
) -> tuple[Progress, Trajectory]:
    """Advance by `save_every` steps of dt [s], scalar or (save_every,), and save the result.

    Args:
        before: the step before each of them (save_every,) [s], 0 for none; None if all are equal.
    """

    def one(
        both: tuple[Progress, Extremes | None], sizes: tuple[Array | None, Array | None]
    ) -> tuple[tuple[Progress, Extremes | None], tuple[Array, ...]]:
        carry, extremes = both
        size, last = sizes
        if size is None:
            size = dt
        if last is not None:
            s, _ = with_step_changed(stepper, model, carry.state, last, size)
            carry = carry._replace(state=s)
        after, taken = next_progress(stepper, model, carry, size)
        extremes = with_step(extremes, watch, model, carry.state, after.state)
        return (after, extremes), (taken.row, taken.retried, taken.failed)

    sizes = (dt if jnp.ndim(dt) else None), before
    both = carry, no_extremes(watch, model, carry.state)
    if save_every == 1:
        (carry, extremes), (residual, retried, bad) = one(both, jax.tree.map(lambda a: a[0], sizes))
        retried = retried.astype(jnp.int32)
        bad = bad.astype(jnp.int32)
    else:
        (carry, extremes), (residual, retried, bad) = jax.lax.scan(one, both, sizes, length=save_every)
        residual = jnp.max(residual)
        retried = jnp.sum(retried, dtype=jnp.int32)
        bad = jnp.sum(bad, dtype=jnp.int32)
    s = carry.state
    counts = residual, retried, bad, carry.first_bad
    return carry, Trajectory(s.r, s.v, s.tension, s.work, *counts, s.parted, s.own, extremes)
