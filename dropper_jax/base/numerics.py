"""Small linear algebra, written out so that it fuses."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from dropper_jax.base.components import inverse_rows


def dot(a: jax.Array, b: jax.Array) -> jax.Array:
    """Scalar products of 3-vectors (..., 3).

    Written out, because on the CPU a sum over an axis of three is a separate kernel, while three products fuse with the
    operations that use them.
    """
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def cross(a: jax.Array, b: jax.Array) -> jax.Array:
    """Vector products of 3-vectors (..., 3), written out for the same reason (and half the operations of jnp's)."""
    x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    z = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return jnp.stack([x, y, z], axis=-1)


def upright(z: jax.Array) -> jax.Array:
    """Vectors (..., 3) along z of these lengths."""
    none = jnp.zeros_like(z)
    return jnp.stack([none, none, z], axis=-1)


def safe_norm(x: jax.Array, floor: float = 1e-30) -> jax.Array:
    """|x| of 3-vectors (..., 3), with finite derivatives at zero (the floor is 1e-15 in |x|)."""
    return jnp.sqrt(dot(x, x) + jnp.asarray(floor, x.dtype))


def horizontal_norm(x: jax.Array) -> jax.Array:
    """The same of the horizontal parts of 3-vectors (..., 3)."""
    return safe_norm(x * jnp.array([1.0, 1.0, 0.0], x.dtype))


def inverse3(m: jax.Array) -> jax.Array:
    """Inverse of 3x3 matrices (..., 3, 3) by cofactors: elementwise work, no LAPACK call per block."""
    return jnp.stack([jnp.stack(row, axis=-1) for row in inverse_rows(m)], axis=-2)
