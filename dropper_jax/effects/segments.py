"""Contact of round bars: the nearest places of two straight axes, and what pushes them apart.

Bars are pieces p of four places (..., 4, 3): the ends of the first axis and of the second.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.base.numerics import dot

#: Rounding of the nearest place where axes are parallel, over the square of their lengths: parallel axes meet in their
#: middles, and the place of the contact moves on evenly as they turn (by 0.3 degrees) to meet elsewhere.
SPREAD = 1e-5
#: Distance over the reach below which axes count as this far apart: the direction of the push stays defined.
CORE = 1e-2


class Nearest(NamedTuple):
    """Where two axes are nearest.

    Attributes:
        distance: (...,) [m].
        separation: gradient of the distance by the place on the first axis (..., 3): a unit vector from the second.
        shares: what the ends of the axes have of the place on the first less that on the second (..., 4).
    """

    distance: jax.Array
    separation: jax.Array
    shares: jax.Array


def nearest_points(p: jax.Array, reach: jax.Array, spread: jax.Array) -> Nearest:
    """The least of `|p0 + s u - q0 - t w|^2 + spread ((s - 1/2)^2 + (t - 1/2)^2)` over s and t from 0 to 1.

    Strictly convex in s and t, so that the places move continuously and the root of the least has the gradient of the
    distance at fixed s and t. Found in three steps: s of the whole plane, t at that s, s at that t, each held between
    0 and 1 (Ericson 2005, 5.1.9, which is exact for any such function).

    Args:
        p: ends of the axes (..., 4, 3) [m]; reach: sum of the radii (...,) [m]; spread: (...,) [m^2].
    """
    u, w, off = p[..., 1, :] - p[..., 0, :], p[..., 3, :] - p[..., 2, :], p[..., 0, :] - p[..., 2, :]
    a, b, c = dot(u, u) + spread, dot(u, w), dot(w, w) + spread
    e, f = 0.5 * spread - dot(u, off), 0.5 * spread + dot(w, off)
    s = jnp.clip((e * c + b * f) / (a * c - b * b), 0.0, 1.0)
    t = jnp.clip((b * s + f) / c, 0.0, 1.0)
    s = jnp.clip((b * t + e) / a, 0.0, 1.0)
    apart = off + s[..., None] * u - t[..., None] * w
    least = dot(apart, apart) + spread * ((s - 0.5) ** 2 + (t - 0.5) ** 2)
    distance = jnp.sqrt(least + (CORE * reach) ** 2)
    return Nearest(distance, apart / distance[..., None], jnp.stack([1.0 - s, s, t - 1.0, -t], axis=-1))


def contact_force(distance: jax.Array, reach: jax.Array, stiffness: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Energy [J] and force [N] of bars pressed together: `V = k/2 p^2 R/d`, `N = k p (R/d) (1 + p/(2 d))`, p = R - d.

    A spring k at first touch; with d of at least `CORE` R the axes meet at 49 k R^2.
    """
    deep, ratio = jnp.maximum(reach - distance, 0.0), reach / distance
    return 0.5 * stiffness * deep**2 * ratio, stiffness * deep * ratio * (1.0 + 0.5 * deep / distance)


def relative_motion(before: jax.Array, after: jax.Array) -> jax.Array:
    """Largest motion (...,) [m] of any place of one axis against any of the other."""
    moved = after - before
    each = moved[..., :2, None, :] - moved[..., None, 2:, :]
    return jnp.sqrt(jnp.max(dot(each, each), axis=(-2, -1)))
