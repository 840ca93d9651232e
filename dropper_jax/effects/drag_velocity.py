"""The velocity used for drag over a step: between the mid-step velocity and the end velocity."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.numerics import dot
from dropper_jax.model import Kinematics

#: Below this z the excess is computed from its series, whose error there is below 1e-13.
SERIES_BELOW = 0.05
#: Rounding of a node's displacement over a step, in units of that of the largest coordinate. 300 random pendulums with
#: drag that stops them at once: 40 have a step without a solution if this is 0, 8 if it is 8, one if it is 64; 300
#: others: 32 if it is 0, 4 if it is 64.
ROUNDING_UNITS = 64.0


def excess(z: Array) -> Array:
    """`2 theta - 1 = coth(z/2) - 2/z`, z >= 0: from z/6 for slow decay to 1 for decay within the step."""
    small = z < SERIES_BELOW
    large = jnp.where(small, 1.0, z)
    series = z / 6.0 * (1.0 - z**2 / 60.0 * (1.0 - z**2 / 42.0))
    return jnp.where(small, series, 1.0 / jnp.tanh(0.5 * large) - 2.0 / large)


def drag_velocity(k: Kinematics, decay: Array) -> Array:
    """`v_mid + (2 theta - 1)(v_mid - v0)` (nodes, 3) [m/s].

    decay (nodes, 1) or (nodes, 3) [1/s] is the rate at which drag alone would stop the nodes. With v_mid = (v0 + v1)/2
    this is `(1 - theta) v0 + theta v1`, theta(z) = 1/(1 - exp(-z)) - 1/z, z = h decay. A motion stopped by linear drag
    alone then follows `exp(-z)` exactly. The mid-step velocity alone would reverse it at every step and keep its size.
    The result approaches v_mid as the step decreases (second order). At a plain instant it is v.
    """
    if k.h is None or k.before is None:
        return k.v
    return k.v + excess(k.h * decay) * (k.v - k.before)


def still_drag_velocity(k: Kinematics, decay: Array) -> Array:
    """`drag_velocity` u in still water, where drag never adds energy: without a component against the motion.

    If another force reverses a light node within a step, u may point against v_mid, and drag would do positive work
    `-u . v_mid`. Drag alone never does so.
    """
    if k.h is None or k.before is None:
        return k.v
    u = drag_velocity(k, decay)
    size = dot(k.v, k.v)
    # the direction of a speed below the rounding of positions is random, and the law would not be solvable: u is then
    # nearly the velocity before the step
    rounding = ROUNDING_UNITS * jnp.finfo(size.dtype).eps / k.h * jnp.max(jnp.abs(jax.lax.stop_gradient(k.r)))
    along = dot(u, k.v) + rounding * jnp.max(jnp.abs(jax.lax.stop_gradient(k.before)), axis=-1)
    against = (along < 0.0) & (size > 1e3 * jnp.finfo(size.dtype).tiny)
    return u - (jnp.where(against, along, 0.0) / jnp.where(against, size, 1.0))[:, None] * k.v
