"""Vectors as three separate arrays. Sums of three arrays fuse with neighbouring operations; sums over an axis do
not."""

from __future__ import annotations

import jax

Components = tuple[jax.Array, jax.Array, jax.Array]


def components(x: jax.Array) -> Components:
    """The three components of vectors (..., 3) as separate arrays.

    On the CPU a sum over an axis of three is a separate kernel. A sum of three arrays fuses with neighbouring
    operations.
    """
    return x[..., 0], x[..., 1], x[..., 2]


def dot(a: Components, b: Components) -> jax.Array:
    """Scalar products."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Components, b: Components) -> Components:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def inverse_rows(node: jax.Array) -> tuple[Components, Components, Components]:
    """Rows of the inverses of 3x3 matrices (..., 3, 3) by cofactors, elementwise."""
    columns = [components(node[..., :, i]) for i in range(3)]
    crosses = [_cross(columns[1], columns[2]), _cross(columns[2], columns[0]), _cross(columns[0], columns[1])]
    scale = 1.0 / dot(columns[0], crosses[0])
    return tuple(tuple(c * scale for c in row) for row in crosses)
