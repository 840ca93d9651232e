"""Submerged fraction of a part of a line, and velocities along and across it.

A link's water forces are distributed to its nodes as its mass is: all to its far node for point-mass links, according
to the centre of mass for compound ones. A node's part is submerged if the surface is above it, smoothly over the height
of the link there.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from dropper_jax.model import Kinematics, LinkEnd

#: A NumPy or JAX array.
AnyArray = Any


def wet_share(k: Kinematics, end: LinkEnd, tangents: Array, elevation: Array) -> Array:
    """Submerged fraction of this end of each link (n,), 0 to 1."""
    height = k.line.needed_diameter + k.line.length * jnp.abs(tangents[:, 2])
    return submerged_fraction(end.at(elevation - k.r[:, 2]), height)


def submerged_fraction(below: AnyArray, height: AnyArray) -> AnyArray:
    """`s^2 (3 - 2 s)`, `s = 1/2 + below/height`, of parts of links whose nodes are `below` the surface [m].

    Args:
        height: vertical extent of each part [m]; of a link `D + L |q_z|`.
    """
    s = (0.5 + below / height).clip(0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


def split(u: Array, tangent: Array) -> tuple[Array, Array]:
    """Components of u (nodes, 3) across and along the tangents."""
    along = jnp.sum(u * tangent, axis=-1, keepdims=True) * tangent
    return u - along, along
