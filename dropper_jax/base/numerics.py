"""Small linear algebra, smooth springs and trigonometry, written out so that they fuse.

The spring of the seabed over a step: resolved motion conserves its energy, unresolved motion is damped.

A spring with the mean force over the step, `(psi1 - psi0)/(s1 - s0)`, conserves all energy, including that of
vibrations that the step does not resolve. A spring with its force at the end of the step takes (h omega)^2/4 of all of
them at every step. `lag` lies between the two. It is zero while the spring moves as expected from the velocities at the
start of the step, or more slowly. It is half of the amount by which the spring runs ahead of them. It is at most the
change itself, with which the force is that at the end. It never adds energy, since it has the sign of the change. A
vibration loses (h omega)^2/4 of its energy per period and none before its peak. Unresolved vibrations shrink to a third
per step.

Sine and cosine together, as elementwise work.

XLA calls the C library for each sine and each cosine of a double, 12 to 15 ns each on the CPU. In a sea of many
components this took most of the time of a step. Written out, the pair takes 2.4 ns.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

# --- vectors as three separate arrays: their sums fuse with neighbouring operations, sums over an axis do not ---

Components = tuple[jax.Array, jax.Array, jax.Array]
#: A pytree of arrays.
Tree = TypeVar("Tree")


def components(x: jax.Array) -> Components:
    """The three components of vectors (..., 3) as separate arrays.

    On the CPU a sum over an axis of three is a separate kernel. A sum of three arrays fuses with neighbouring
    operations.
    """
    return x[..., 0], x[..., 1], x[..., 2]


def dot_components(a: Components, b: Components) -> jax.Array:
    """Scalar products."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Components, b: Components) -> Components:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def inverse_rows(node: jax.Array) -> tuple[Components, Components, Components]:
    """Rows of the inverses of 3x3 matrices (..., 3, 3) by cofactors, elementwise."""
    columns = [components(node[..., :, i]) for i in range(3)]
    crosses = [_cross(columns[1], columns[2]), _cross(columns[2], columns[0]), _cross(columns[0], columns[1])]
    scale = 1.0 / dot_components(columns[0], crosses[0])
    return tuple(tuple(c * scale for c in row) for row in crosses)


def store_once(x: Tree) -> Tree:
    """The arrays of `x`, read by many operations: XLA would compute them again for every reader.

    Members of a batch that advance side by side on the CPU compute them once: half of the operations of a step of the
    lab dropper, and 1.14 (`rattle`) to 1.28 times as fast. Other programs are not changed.
    """
    return jax.lax.optimization_barrier(x) if jax.default_backend() == "cpu" else x


#: Decorator of small functions that programs use many times: traced once per shape, one program where called alone.
trace_once = partial(jax.jit, inline=True)


@trace_once
def dot(a: jax.Array, b: jax.Array) -> jax.Array:
    """Scalar products of 3-vectors (..., 3).

    Written out, because on the CPU a sum over an axis of three is a separate kernel, while three products fuse with the
    operations that use them.
    """
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


@trace_once
def cross(a: jax.Array, b: jax.Array) -> jax.Array:
    """Vector products of 3-vectors (..., 3), written out for the same reason (and half the operations of jnp's)."""
    return jnp.stack(_cross(components(a), components(b)), axis=-1)


def upright(z: jax.Array) -> jax.Array:
    """Vectors (..., 3) along z of these lengths."""
    none = jnp.zeros_like(z)
    return jnp.stack([none, none, z], axis=-1)


@trace_once
def safe_norm(x: jax.Array, floor: float = 1e-30) -> jax.Array:
    """|x| of 3-vectors (..., 3), with finite derivatives at zero (the floor is 1e-15 in |x|)."""
    return jnp.sqrt(dot(x, x) + jnp.asarray(floor, x.dtype))


def time_just_after(t: jax.Array, side: float = 1.0) -> jax.Array:
    """An instant just after t (before it with side -1): a quantity that jumps at t has its value on that side."""
    return t + 8.0 * side * jnp.finfo(t.dtype).eps * jnp.maximum(jnp.abs(t), 1.0)


def horizontal_norm(x: jax.Array) -> jax.Array:
    """The same of the horizontal parts of 3-vectors (..., 3)."""
    return safe_norm(x * jnp.array([1.0, 1.0, 0.0], x.dtype))


def positive_part(x: jax.Array) -> jax.Array:
    """`max(x, 0)`; its slope at 0 is 1. A link at exactly its natural length has the derivatives of a taut one, not the
    mean of two."""
    return jnp.where(x < 0.0, 0.0, x)


@trace_once
def mean_positive_part(e0: jax.Array, e1: jax.Array) -> jax.Array:
    """Mean of max(e, 0) between e0 and e1: `(s1^2 - s0^2)/(2 (e1 - e0))`, s = max(e, 0), without cancellation."""
    pulled, way = positive_part(e0) + positive_part(e1), jnp.abs(e0) + jnp.abs(e1)
    return 0.5 * pulled * (pulled / jnp.where(way > 0.0, way, 1.0))


#: Stretch and depth [m per m] below which a spring counts as at rest.
REST = 1e-10


@trace_once
def lag(before: jax.Array, after: jax.Array, expected: jax.Array, rest: jax.Array | float = 0.0) -> jax.Array:
    """Spring force beyond its mean over the step, from the force before, the force after and the expected force.

    From a spring at rest any motion is ahead of what was expected. The derivative there is that of `after - expected`,
    not that of a sign determined by rounding. Changes up to `rest` count as zero, those above 4 times as motion. The
    force is blended between them: a step cannot solve a jump that is larger than its tolerance.
    """
    change, ahead = after - before, 0.5 * (after - expected)
    smaller = jnp.where(jnp.abs(ahead) <= jnp.abs(change), ahead, change)
    moving = jnp.where(change * ahead > 0.0, smaller, 0.0)
    size, width = jnp.maximum(jnp.abs(change), jnp.abs(ahead)), 3.0 * rest
    still = jnp.clip((rest + width - size) / jnp.where(width > 0.0, width, 1.0), 0.0, 1.0)
    still = jnp.where(width > 0.0, still, size <= 0.0)
    return 0.5 * (still * ahead + (1.0 - still) * moving)


def never_more(damper: jax.Array, spring: jax.Array) -> jax.Array:
    """Force that a damper adds to a spring force `spring` >= 0: at most as much again, and at most all of it
    removed. Without a spring force the damper has no force, and no derivative either."""
    return jnp.where(spring > 0.0, jnp.clip(damper, -spring, spring), 0.0)


#: pi/2 in three parts by the number of bytes of the type. The first two are so short that products with whole numbers
#: below 2^20 (float32: 2^13) are exact (Cody and Waite 1980).
HALF_PI = {
    8: (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21),
    4: (1.5703125, 4.837512969970703125e-4, 7.54978995489188216e-8),
}
#: Taylor coefficients of `(sin r - r)/r^3` and `(cos r - 1 + r^2/2)/r^4` in powers of r^2, |r| <= pi/4: the first
#: omitted term is below 1e-17 of the sum.
SIN = (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800, 1 / 6227020800, -1 / 1307674368000)
COS = (1 / 24, -1 / 720, 1 / 40320, -1 / 3628800, 1 / 479001600, -1 / 87178291200, 1 / 20922789888000)


@jax.custom_jvp
def sincos(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """`(sin x, cos x)` to 2 roundings of 1 for |x| below 1e6 [rad]; float32: 1e4."""
    return _sincos(x)


@trace_once
def _sincos(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    turns = jnp.round(x * (2.0 / jnp.pi))
    r = x
    for part in HALF_PI[x.dtype.itemsize]:
        r = r - turns * part
    square = r * r
    sin, cos = jnp.full_like(r, SIN[-1]), jnp.full_like(r, COS[-1])
    for a, b in zip(SIN[-2::-1], COS[-2::-1], strict=True):
        sin, cos = sin * square + a, cos * square + b
    sin = r + r * square * sin
    cos = 1.0 - 0.5 * square + square * square * cos
    quarter = turns - 4.0 * jnp.floor(0.25 * turns)
    odd = (quarter == 1.0) | (quarter == 3.0)
    first, second = jnp.where(odd, cos, sin), jnp.where(odd, sin, cos)
    return jnp.where(quarter >= 2.0, -first, first), jnp.where((quarter == 1.0) | (quarter == 2.0), -second, second)


@sincos.defjvp
def _sincos_jvp(primals: tuple[jax.Array], tangents: tuple[jax.Array]) -> tuple[tuple[jax.Array, ...], ...]:
    sin, cos = sincos(*primals)
    (dx,) = tangents
    return (sin, cos), (cos * dx, -sin * dx)


# Sums at indices known when a program is traced, as gathers: a scatter prevents a run from becoming one kernel


def index_table(lists: Sequence[Sequence[int]], none: int) -> np.ndarray:
    """Lists of unequal length as columns (most, lists), filled with `none`."""
    table = np.full((max(map(len, lists), default=0), len(lists)), none)
    for column, numbers in zip(table.T, lists, strict=True):
        column[: len(numbers)] = numbers
    return table


def with_zero_row(a: jax.Array) -> jax.Array:
    """Rows (n + 1, ...), the last one zero."""
    return jnp.concatenate([a, jnp.zeros_like(a, shape=(1, *a.shape[1:]))])


def gather_sums(a: jax.Array, table: np.ndarray) -> jax.Array:
    """Sums (m, ...) of the rows of a (n, ...) that a static table (most, m) lists; the index n is a zero row."""
    if not len(table):
        return jnp.zeros((table.shape[1], *a.shape[1:]), a.dtype)
    a = with_zero_row(a)
    return sum((a[row] for row in table[1:]), a[table[0]])


def scatter_add(where: np.ndarray, values: jax.Array | np.ndarray, size: int) -> jax.Array:
    """`zeros(size, ...)` with `values` (k, ...) added at the rows `where` (k,)."""
    where = np.asarray(where)
    counts = np.bincount(where, minlength=size)
    if isinstance(values, np.ndarray):
        found = np.zeros((size, *values.shape[1:]), values.dtype)
        np.add.at(found, where, values)
        return jnp.asarray(found, values.dtype)
    if not len(where):
        return jnp.zeros((size, *values.shape[1:]), values.dtype)
    if len(where) == size and counts.max() == 1:
        return values if (where == np.arange(size)).all() else values[np.argsort(where)]
    order = np.argsort(where, kind="stable")
    return gather_sums(values, index_table(np.split(order, np.cumsum(counts)[:-1]), len(where)))


def scatter_add_many(where: np.ndarray, values: jax.Array, size: int) -> jax.Array:
    """`scatter_add`, using a scatter if many values meet at one row, as in contact between all pairs of links."""
    where = np.asarray(where)
    # maximum number of values per row for which gathers are used: each is a separate operation
    if not len(where) or np.bincount(where, minlength=size).max() <= 8:
        return scatter_add(where, values, size)
    return jnp.zeros((size, *values.shape[1:]), values.dtype).at[where].add(values)
