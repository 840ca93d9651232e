"""Tridiagonal systems, `lower_i x_(i-1) + diagonal_i x_i + upper_i x_(i+1) = rhs_i`.

Where a run becomes one kernel they are solved by cyclic reduction, written out: every other row is eliminated at once,
log2(n) rounds of elementwise work, nothing that calls a library. It does not pivot: meant for matrices like
`G M^-1 G'`, whose pivots are as large as what they carry. Elsewhere the device's library solves them, as one call among
many kernels.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.lax import linalg

from dropper_jax.base.one_kernel import compiled_whole


def solve_tridiagonal(lower: jax.Array, diagonal: jax.Array, upper: jax.Array, rhs: jax.Array) -> jax.Array:
    """The solution (n,) of one system of n rows.

    Args:
        lower, diagonal, upper: (n,) each; the first lower and the last upper entry must be zero.
        rhs: (n,) or (n, c).
    """
    if compiled_whole(diagonal.shape[0]):
        if rhs.ndim == 1:
            return cyclic_reduction(lower, diagonal, upper, rhs)
        return jax.vmap(cyclic_reduction, in_axes=(None, None, None, 1), out_axes=1)(lower, diagonal, upper, rhs)
    columns = rhs.reshape(rhs.shape[0], -1)
    return linalg.tridiagonal_solve(lower, diagonal, upper, columns).reshape(rhs.shape)


@jax.custom_jvp
def cyclic_reduction(lower: jax.Array, diagonal: jax.Array, upper: jax.Array, rhs: jax.Array) -> jax.Array:
    """The solution (n,) by cyclic reduction, whatever the device; `rhs` (n,).

    For systems inside inner loops: XLA's CPU compiler makes one function of a short loop even where that holds a call
    of a library, which then is not found (JAX 0.10.1).
    """
    return _halved(lower, diagonal, upper, rhs)


@cyclic_reduction.defjvp
def _cyclic_reduction_jvp(
    primals: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]
) -> tuple[jax.Array, jax.Array]:
    (lower, diagonal, upper, rhs), (dl, dd, du, db) = primals, tangents
    x = cyclic_reduction(lower, diagonal, upper, rhs)
    zero = jnp.zeros_like(x[:1])
    before, after = jnp.concatenate([zero, x[:-1]]), jnp.concatenate([x[1:], zero])
    return x, cyclic_reduction(lower, diagonal, upper, db - dl * before - dd * x - du * after)


def _halved(lower: jax.Array, diagonal: jax.Array, upper: jax.Array, rhs: jax.Array) -> jax.Array:
    """The same, every second row put into its neighbours."""
    n = diagonal.shape[0]
    if n == 1:
        return rhs / diagonal
    odd = n // 2
    even = n - odd
    pivot = 1.0 / diagonal[1::2]
    low, up, b = lower[1::2] * pivot, upper[1::2] * pivot, rhs[1::2] * pivot
    low0, up0, b0 = (_shifted(a, 1, even) for a in (low, up, b))
    low1, up1, b1 = (_shifted(a, 0, even) for a in (low, up, b))
    lo, u = lower[0::2], upper[0::2]
    kept = _halved(-lo * low0, diagonal[0::2] - u * low1 - lo * up0, -u * up1, rhs[0::2] - u * b1 - lo * b0)
    following = kept[1 : odd + 1] if even > odd else _shifted(kept[1:], 0, odd)
    between = b - low * kept[:odd] - up * following
    both = jnp.stack([kept, _shifted(between, 0, even)], axis=1)
    return both.reshape(2 * even)[:n]


def _shifted(a: jax.Array, before: int, length: int) -> jax.Array:
    """`a` with `before` zeros in front, cut or filled up with zeros to `length`."""
    a = a[: length - before]
    return jnp.pad(a, (before, length - before - a.shape[0]))
