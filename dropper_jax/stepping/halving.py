"""Over an interval by one step, or by shorter ones if a step does not converge: nothing inside a step repeats it.

A step that does not converge is rejected, and half of it is tried; after an accepted step twice as much, up to the
interval. A rejected step leaves no trace in the state: works, internal states of effects and broken links are those
before it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.numerics import safe_norm
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper, step

#: Maximum relative change of a rigid link's length under a scheme with constraint drift (explicit Euler).
DRIFT_LIMIT = 0.1
#: Rounding of fractions of an interval.
ROUNDING = 1e-9


class Interval(NamedTuple):
    """Steps over an interval so far.

    Attributes:
        state: at the end of the last accepted step.
        done, wanted: fraction of the interval that is done, and that of the next step.
        row: largest scaled row of the accepted steps.
        retried: whether a step was rejected.
        failed: whether a step was accepted that failed.
    """

    state: State
    done: Array
    wanted: Array
    row: Array
    retried: Array
    failed: Array

    @property
    def unfinished(self) -> Array:
        """Whether the end is not reached."""
        return self.done < 1.0 - ROUNDING


def begin_interval(s: State) -> Interval:
    """An interval that starts at s, to be taken in one step."""
    none = jnp.zeros((), s.r.dtype)
    no = jnp.zeros((), bool)
    return Interval(jax.tree.map(jnp.asarray, s), none, none + 1.0, none, no, no)


def attempt(
    stepper: Stepper, model: Model, now: Interval, interval: Array, alive: Array | bool = True
) -> tuple[Interval, Array]:
    """After one more step was tried: the interval, and the fraction of it that the step advanced (0 if rejected)."""
    shortest = 0.5**stepper.halvings
    left = 1.0 - now.done
    part = left / jnp.ceil(left / now.wanted - ROUNDING)
    after, row = step(stepper, model, now.state, part * interval)
    solved = ~step_failed(stepper, model, after, row)
    last_resort = part <= (1.0 + ROUNDING) * shortest
    accepted = solved | last_resort | now.failed | ~jnp.asarray(alive)
    longer = jnp.minimum(2.0 * part, 1.0)
    shorter = jnp.maximum(0.5 * part, shortest)
    following = Interval(
        state=jax.tree.map(partial(jnp.where, accepted), after, now.state),
        done=jnp.where(accepted, now.done + part, now.done),
        wanted=jnp.where(accepted, longer, shorter),
        row=jnp.where(accepted & ~(row <= now.row), row, now.row),  # a NaN remains
        retried=now.retried | ~accepted,
        failed=now.failed | (accepted & ~solved),
    )
    return following, jnp.where(accepted, part, 0.0)


def advance_over(stepper: Stepper, model: Model, s: State, interval: Array, alive: Array | bool = True) -> Interval:
    """The interval from s of this length [s], done.

    With `stepper.halvings` derivatives exist in forward mode, with the lengths of the steps held constant; without in
    both modes.

    Args:
        alive: whether the run is still valid; otherwise failed steps are accepted as they are.
    """
    start = begin_interval(s)
    if not stepper.halvings or not stepper.integrator.implicit:
        after, row = step(stepper, model, start.state, interval)
        return start._replace(state=after, row=row, failed=step_failed(stepper, model, after, row))

    def try_one(now: Interval) -> Interval:
        return attempt(stepper, model, now, interval, alive)[0]

    end = jax.lax.while_loop(lambda now: now.unfinished, try_one, start)
    return end._replace(state=replace(end.state, t=s.t + interval))


def step_failed(stepper: Stepper, model: Model, s: State, row: Array) -> Array:
    """Whether the step that led to `s` failed: not converged, not finite, or with constraint drift."""
    bad = ~(row <= stepper.limit(model))
    if stepper.integrator.holds_length:
        return bad
    size = safe_norm(model.links(s.r, model.ends(s.t)))
    return bad | ~(jnp.max(jnp.abs(size / model.line.length - 1.0)) <= DRIFT_LIMIT)
