"""The force of a spring over a step: resolved motion conserves its energy, unresolved motion is damped.

A spring with the mean force over the step, `(psi1 - psi0)/(s1 - s0)`, conserves all energy, including that of
vibrations that the step does not resolve. A spring with its force at the end of the step takes (h omega)^2/4 of all of
them at every step. With `unresolved_force` it lies between the two. It is zero while the spring moves as expected
from the velocities at the start of the step, or more slowly. It is half of the amount by which the spring runs ahead of
them. It is at most the change itself, with which the force is that at the end. It never adds energy, since it has the
sign of the change. A vibration loses (h omega)^2/4 of its energy per period and none before its peak. Unresolved
vibrations shrink to a third per step.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.numerics import positive_part, trace_once


@trace_once
def mean_positive_part(e0: Array, e1: Array) -> Array:
    """Mean of max(e, 0) between e0 and e1: `(s1^2 - s0^2)/(2 (e1 - e0))`, s = max(e, 0), without cancellation."""
    total = positive_part(e0) + positive_part(e1)
    size = jnp.abs(e0) + jnp.abs(e1)
    return 0.5 * total * (total / jnp.where(size > 0.0, size, 1.0))


#: Stretch and depth [m per m] below which a spring counts as at rest.
REST_DEPTH = 1e-10


@trace_once
def unresolved_force(before: Array, after: Array, expected: Array, rest: Array | float = 0.0) -> Array:
    """Spring force beyond its mean over the step, from the force before, the force after and the expected force.

    From a spring at rest any motion is ahead of what was expected. The derivative there is that of `after - expected`,
    not that of a sign determined by rounding. Changes up to `rest` count as zero, those above 4 times as motion. The
    force is blended between them: a step cannot solve a jump that is larger than its tolerance.
    """
    change = after - before
    ahead = 0.5 * (after - expected)
    smaller = jnp.where(jnp.abs(ahead) <= jnp.abs(change), ahead, change)
    moving = jnp.where(change * ahead > 0.0, smaller, 0.0)
    size = jnp.maximum(jnp.abs(change), jnp.abs(ahead))
    width = 3.0 * rest
    still = jnp.clip((rest + width - size) / jnp.where(width > 0.0, width, 1.0), 0.0, 1.0)
    still = jnp.where(width > 0.0, still, size <= 0.0)
    return 0.5 * (still * ahead + (1.0 - still) * moving)


def limit_damper(damper: Array, spring: Array) -> Array:
    """Force that a damper adds to a spring force `spring` >= 0: at most as much again, and at most all of it
    removed. Without a spring force the damper has no force, and no derivative either."""
    return jnp.where(spring > 0.0, jnp.clip(damper, -spring, spring), 0.0)
