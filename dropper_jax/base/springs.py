"""Springs over a step: what the step follows they keep, what it does not follow they take.

A spring that pulls with its mean over the step, `(psi1 - psi0)/(s1 - s0)`, keeps all energy, of vibrations too that the
step does not resolve. One that pulls with its value at the end takes (h omega)^2/4 of all of them at every step. So
`lag` stands between: nothing while the spring does what the speeds at the beginning of the step led to expect, or
slows down; half of what it runs ahead of them; at most the change itself, with which the pull is that at the end. It
never gives energy, as it has the sign of the change. A vibration loses (h omega)^2/4 of its energy per period, none on
its way to a peak; what is not resolved shrinks to a third from step to step.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp


def mean_positive_part(e0: jax.Array, e1: jax.Array) -> jax.Array:
    """Mean of max(e, 0) between e0 and e1: `(s1^2 - s0^2)/(2 (e1 - e0))`, s = max(e, 0), without cancellation."""
    pulled, way = jnp.maximum(e0, 0.0) + jnp.maximum(e1, 0.0), jnp.abs(e0) + jnp.abs(e1)
    return 0.5 * pulled * (pulled / jnp.where(way > 0.0, way, 1.0))


#: Stretch and depth [m per m] below which a spring counts as at rest.
REST = 1e-10


def lag(before: jax.Array, after: jax.Array, expected: jax.Array, rest: jax.Array | float = 0.0) -> jax.Array:
    """What a spring pulls beyond its mean over the step, by its pull before, after, and the one expected.

    From a spring at rest any motion is ahead of what was expected: its derivative there is that of `after - expected`,
    not of a sign that rounding decides. Changes up to `rest` count as none.
    """
    change, ahead = after - before, 0.5 * (after - expected)
    smaller = jnp.where(jnp.abs(ahead) <= jnp.abs(change), ahead, change)
    still = jnp.maximum(jnp.abs(change), jnp.abs(ahead)) <= rest
    return 0.5 * jnp.where(still, ahead, jnp.where(change * ahead > 0.0, smaller, 0.0))


def never_more(damper: jax.Array, spring: jax.Array) -> jax.Array:
    """What a damper adds to a spring that pulls with `spring` >= 0: at most as much again, at most all of it off."""
    return jnp.clip(damper, -spring, spring)
