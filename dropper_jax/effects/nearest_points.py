"""The nearest points of two straight axes, and the force that pushes them apart.

Bars are pieces p of four positions (..., 4, 3): the ends of the first axis and of the second.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.numerics import dot


class Nearest(NamedTuple):
    """Nearest points of two axes.

    Attributes:
        distance: (...,) [m].
        separation: gradient of the distance with respect to the point on the first axis (..., 3): a unit vector away
            from the second.
        shares: weights of the ends of the axes in the difference of the two nearest points (..., 4).
    """

    distance: Array
    separation: Array
    shares: Array


#: Distance of crossing axes relative to the reach, which keeps the direction of the force defined.
MIN_DISTANCE = 1e-2


def nearest_points(p: Array, reach: Array, rounding: Array) -> Nearest:
    """The minimum of `|p0 + s u - q0 - t w|^2 + rounding ((s - 1/2)^2 + (t - 1/2)^2)` over s and t from 0 to 1.

    The function is strictly convex in s and t, so the points move continuously, and the root of the minimum has the
    gradient of the distance at fixed s and t. It is found in three steps: s without the limits on t, t at that s, s at
    that t, each clipped to 0 to 1 (Ericson 2005, 5.1.9, which is exact for any such function).

    Args:
        p: ends of the axes (..., 4, 3) [m]; reach: sum of the radii (...,) [m]; rounding: (...,) [m^2].
    """
    u = p[..., 1, :] - p[..., 0, :]
    w = p[..., 3, :] - p[..., 2, :]
    off = p[..., 0, :] - p[..., 2, :]
    a = dot(u, u) + rounding
    b = dot(u, w)
    c = dot(w, w) + rounding
    e = 0.5 * rounding - dot(u, off)
    f = 0.5 * rounding + dot(w, off)
    s = jnp.clip((e * c + b * f) / (a * c - b * b), 0.0, 1.0)
    t = jnp.clip((b * s + f) / c, 0.0, 1.0)
    s = jnp.clip((b * t + e) / a, 0.0, 1.0)
    difference = off + s[..., None] * u - t[..., None] * w
    minimum = dot(difference, difference) + rounding * ((s - 0.5) ** 2 + (t - 0.5) ** 2)
    distance = jnp.sqrt(minimum + (MIN_DISTANCE * reach) ** 2)
    return Nearest(distance, difference / distance[..., None], jnp.stack([1.0 - s, s, t - 1.0, -t], axis=-1))


def contact_force(distance: Array, reach: Array, stiffness: Array) -> tuple[Array, Array]:
    """Energy [J] and force [N] of compressed bars: `V = k/2 p^2 R/d`, `N = k p (R/d) (1 + p/(2 d))`, p = R - d.

    A spring k at first touch; with d of at least R/100 the axes meet at 49 k R^2.
    """
    deep = jnp.maximum(reach - distance, 0.0)
    ratio = reach / distance
    return 0.5 * stiffness * deep**2 * ratio, stiffness * deep * ratio * (1.0 + 0.5 * deep / distance)


def relative_motion(before: Array, after: Array) -> Array:
    """Maximum motion (...,) [m] of any point of one axis relative to any point of the other."""
    moved = after - before
    each = moved[..., :2, None, :] - moved[..., None, 2:, :]
    return jnp.sqrt(jnp.max(dot(each, each), axis=(-2, -1)))
