"""Small linear algebra, written out so that it fuses, and small functions of arrays."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar, overload

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

Components = tuple[Array, Array, Array]
#: A pytree of arrays.
Tree = TypeVar("Tree")


@overload
def as_array(values: None) -> None: ...
@overload
def as_array(values: Any) -> Array: ...
def as_array(values: Any) -> Array | None:
    """Numbers of a scene as an array of JAX, without a program of JAX; None remains None."""
    if values is None:
        return None
    return jnp.asarray(np.asarray(values))


def components(x: Array) -> Components:
    """The three components of vectors (..., 3) as separate arrays.

    On the CPU a sum over an axis of three is a separate kernel. A sum of three arrays fuses with neighbouring
    operations.

    Raises:
        ValueError: vectors of another length, of which JAX would silently repeat the last component.
    """
    if x.shape[-1] != 3:
        raise ValueError(f"vectors of shape {x.shape}; needed: (..., 3)")
    return x[..., 0], x[..., 1], x[..., 2]


def each(f: Callable[[Array], Array], x: Components) -> Components:
    """A function of each component."""
    return f(x[0]), f(x[1]), f(x[2])


def dot_components(a: Components, b: Components) -> Array:
    """Scalar products."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Components, b: Components) -> Components:
    """Vector products."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def inverse_rows(node: Array) -> tuple[Components, Components, Components]:
    """Rows of the inverses of 3x3 matrices (..., 3, 3) by cofactors, elementwise."""
    first, second, third = (components(node[..., :, i]) for i in range(3))
    row = _cross(second, third)
    scale = 1.0 / dot_components(first, row)

    def scaled(row: Components) -> Components:
        return each(lambda c: c * scale, row)

    return scaled(row), scaled(_cross(third, first)), scaled(_cross(first, second))


def store_once(x: Tree) -> Tree:
    """The arrays of `x`, read by many operations: XLA would compute them again for every reader.

    Members of a batch that advance side by side on the CPU compute them once: half of the operations of a step of the
    lab dropper, and 1.14 (`rattle`) to 1.28 times as fast. Other programs are not changed.
    """
    if jax.default_backend() == "cpu":
        return jax.lax.optimization_barrier(x)
    return x


#: Decorator of small functions that programs use many times: traced once per shape, one program where called alone.
trace_once = partial(jax.jit, inline=True)


def local_jacobian(f: Callable[[Array], Tree], x: Array) -> Tree:
    """Blocks (n, ..., c) of a map that acts on each row of x (n, c), or each entry (n,), by itself.

    All rows move together, so `jax.jacfwd` needs one direction per column.
    """
    return jax.jacfwd(lambda e: f(x + e))(jnp.zeros(x.shape[1:], x.dtype))


@trace_once
def dot(a: Array, b: Array) -> Array:
    """Scalar products of 3-vectors (..., 3).

    Written out, because on the CPU a sum over an axis of three is a separate kernel, while three products fuse with the
    operations that use them.
    """
    return dot_components(components(a), components(b))


@trace_once
def cross(a: Array, b: Array) -> Array:
    """Vector products of 3-vectors (..., 3), written out for the same reason (and half the operations of jnp's)."""
    return jnp.stack(_cross(components(a), components(b)), axis=-1)


def upright(z: Array) -> Array:
    """Vectors (..., 3) along z of these lengths."""
    none = jnp.zeros_like(z)
    return jnp.stack([none, none, z], axis=-1)


@trace_once
def safe_norm(x: Array) -> Array:
    """|x| of 3-vectors (..., 3), with finite derivatives at zero: `sqrt(x . x + 1e-30)`."""
    return jnp.sqrt(dot(x, x) + jnp.asarray(1e-30, x.dtype))


def spread(values: np.ndarray, names: tuple[str, ...] = ("min", "mean", "std", "max")) -> dict[str, float]:
    """Minimum, mean, standard deviation and maximum, or some of them."""
    return {name: float(getattr(np, name)(values)) for name in names}


def unit_vectors(x: np.ndarray) -> np.ndarray:
    """Directions of vectors (..., 3) of NumPy; zero without one. Vectors of a failed run may be infinite."""
    with np.errstate(invalid="ignore"):
        return x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-300)


def time_just_after(t: Array, side: float = 1.0) -> Array:
    """An instant just after t (before it with side -1): a quantity that jumps at t has its value on that side."""
    return t + 8.0 * side * jnp.finfo(t.dtype).eps * jnp.maximum(jnp.abs(t), 1.0)


def horizontal_norm(x: Array) -> Array:
    """`safe_norm` of the horizontal parts of 3-vectors (..., 3)."""
    return safe_norm(x * jnp.array([1.0, 1.0, 0.0], x.dtype))


def positive_part(x: Array) -> Array:
    """`max(x, 0)`; its slope at 0 is 1. A link at exactly its natural length has the derivatives of a taut one, not the
    mean of two."""
    return jnp.where(x < 0.0, 0.0, x)
