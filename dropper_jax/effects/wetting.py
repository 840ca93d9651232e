"""The submerged fraction of a link's part."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp

from dropper_jax.model import Kinematics, Part


def parts(k: Kinematics) -> Iterator[Part]:
    """The parts of the lines' water forces."""
    return k.line.parts()


def wet_share(k: Kinematics, part: Part, tangents: jax.Array, elevation: jax.Array) -> jax.Array:
    """Submerged fraction of each row (rows,), 0 to 1."""
    line = k.line
    height = part.take(line.diameter * jnp.ones_like(line.length) + line.length * jnp.abs(tangents[:, 2]))
    # a free end has no next link: its near part has no height and its share is zero
    height = jnp.where(height > 0.0, height, 1.0)
    s = jnp.clip(0.5 + part.at(elevation - k.r[:, 2]) / height, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


def split(u: jax.Array, tangent: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Components of u (nodes, 3) across and along the tangents."""
    along = jnp.sum(u * tangent, axis=-1, keepdims=True) * tangent
    return u - along, along
