"""Equal steps, or known ones, from one saved time to the next."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.model import Model
from dropper_jax.residual import Stepper
from dropper_jax.stepping.extremes import Extremes, Watch, no_extremes, with_step
from dropper_jax.stepping.halving import Interval, advance_over
from dropper_jax.stepping.progress import Progress, Trajectory
from dropper_jax.stepping.step_change import with_step_changed


class _Lengths(NamedTuple):
    """Lengths (save_every,) [s] of the steps to the next saved time, and of the step before each, 0 for none; None
    where all are equal."""

    step: Array | None
    before: Array | None


class _Reached(NamedTuple):
    """The run after some of these steps, and the extremes of its watched signals over them."""

    progress: Progress
    extremes: Extremes | None


class _StepQuality(NamedTuple):
    """Largest scaled row of a step, whether it was repeated in parts, and whether it failed."""

    row: Array
    retried: Array
    failed: Array


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

    def take_step(reached: _Reached, length: _Lengths) -> tuple[_Reached, _StepQuality]:
        progress = reached.progress
        own = dt if length.step is None else length.step
        if length.before is not None:
            s, _ = with_step_changed(stepper, model, progress.state, length.before, own)
            progress = progress._replace(state=s)
        after, taken = next_progress(stepper, model, progress, own)
        extremes = with_step(reached.extremes, watch, model, progress.state, after.state)
        return _Reached(after, extremes), _StepQuality(taken.row, taken.retried, taken.failed)

    lengths = _Lengths(dt if jnp.ndim(dt) else None, before)
    start = _Reached(carry, no_extremes(watch, model, carry.state))
    if save_every == 1:
        end, quality = take_step(start, jax.tree.map(lambda a: a[0], lengths))
    else:
        end, quality = jax.lax.scan(take_step, start, lengths, length=save_every)
    s = end.progress.state
    row = Trajectory(
        r=s.r,
        v=s.v,
        tension=s.tension,
        work=s.work,
        residual=jnp.max(quality.row),
        retried=jnp.sum(quality.retried, dtype=jnp.int32),
        failed=jnp.sum(quality.failed, dtype=jnp.int32),
        first_bad=end.progress.first_bad,
        parted=s.parted,
        own=s.own,
        extremes=end.extremes,
    )
    return end.progress, row
