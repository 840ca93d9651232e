"""Sparse systems of small blocks, solved by rounds of nodes that are not neighbours (see `order`).

With D the blocks of the nodes of a round, L their rows for their neighbours and U the rows of the neighbours for them,

    A' = A - U D^-1 L,    b' = b - U D^-1 b_D;    back: x_D = D^-1 (b_D - L x)

The operations are gathers by static tables and elementwise products, without library calls or scatters, so a loop
around them can be one kernel. A longline of 99 nodes takes 23 us, compared with 174 us for padded lines and a dense
matrix of their points. There is no pivoting between blocks: the method is for matrices like inertia plus stiffness.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.solvers.blocks import inverse, multiply, optimization_barrier
from dropper_jax.solvers.order import Order, Round


class Eliminated(NamedTuple):
    """Blocks of one round: D^-1 (width, k, k), L and U (degree, width, k, k)."""

    inverse: jax.Array
    lower: jax.Array
    upper: jax.Array


class Elimination(NamedTuple):
    """A factored matrix."""

    order: Order
    rounds: tuple[Eliminated, ...]

    def transpose(self) -> Elimination:
        flip = lambda a: jnp.swapaxes(a, -1, -2)  # noqa: E731
        return self._replace(rounds=tuple(Eliminated(flip(d), flip(up), flip(low)) for d, low, up in self.rounds))


def _with_zero(a: jax.Array) -> jax.Array:
    return jnp.concatenate([a, jnp.zeros_like(a, shape=(1, *a.shape[1:]))])


def gather_sums(a: jax.Array, table: np.ndarray) -> jax.Array:
    """Sums (m, ...) of the rows of a (n, ...) that a static table (most, m) lists; the index n is a zero row."""
    a = _with_zero(a)
    return sum((a[row] for row in table[1:]), a[table[0]])


def eliminate(order: Order, blocks: jax.Array) -> Elimination:
    """Factor the matrix with blocks (blocks, k, k) in the order given to `elimination_order`."""
    rounds = []
    if order.rounds:
        blocks = gather_sums(optimization_barrier(blocks), order.slot)
    for table in order.rounds:
        done, blocks = _eliminate(table, blocks)
        rounds.append(done)
    return Elimination(order, tuple(rounds))


def _eliminate(table: Round, blocks: jax.Array) -> tuple[Eliminated, jax.Array]:
    """Blocks of one round, and those of the next."""
    width, degree, k = table.width, table.degree, blocks.shape[-1]
    beside = blocks[width : (1 + 2 * degree) * width].reshape(2, degree, width, k, k)
    done = Eliminated(inverse(blocks[:width]), beside[0], beside[1])
    after = _with_zero(blocks)[table.keep]
    if table.change.size:
        products = multiply(done.upper[:, None], multiply(done.inverse, done.lower))
        after = after - gather_sums(products.reshape(-1, k, k), table.change)
    return done, after


def solve(factor: Elimination, rhs: jax.Array) -> jax.Array:
    """x (nodes, k) of right sides (nodes, k)."""
    order, left, found = factor.order, rhs[factor.order.nodes], []
    for table, done in zip(order.rounds, factor.rounds, strict=True):
        own, left = left[: table.width], left[table.width :]
        found.append(own)
        if table.change_rows.size:
            moved = apply(done.upper, apply(done.inverse, own))
            left = left - gather_sums(moved.reshape(-1, rhs.shape[-1]), table.change_rows)
    x = left
    for table, done, own in zip(order.rounds[::-1], factor.rounds[::-1], found[::-1], strict=True):
        if table.degree:
            own = own - jnp.sum(apply(done.lower, _with_zero(x)[table.neighbours]), axis=0)
        x = jnp.concatenate([apply(done.inverse, own), x])
    return x[order.position]


def apply(a: jax.Array, x: jax.Array) -> jax.Array:
    """Blocks (..., k, k) times vectors (..., k)."""
    return jnp.sum(a * x[..., None, :], axis=-1)
