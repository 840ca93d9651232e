"""Tangent stiffness of an equilibrium: its blocks, and linear solves with it inside a compiled program.

    K = -dF/dr,    K dr = dF        (F: all static forces on free nodes, including the tensions of links)

K is exact: it includes drag that turns with the links, contact and wetted fractions. Its blocks come from a handful of
directional derivatives (`Tangent.seeds`) and are eliminated in rounds (`solvers.elimination`) in O(n). If a node can
move freely K is singular: `K + kappa` is eliminated, and the solution is refined with K itself. This gives a
solution, the shortest one if K is symmetric, or NaN if the system has none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import lu_factor, lu_solve

from dropper_jax.base.indexed_sums import scatter_add_many
from dropper_jax.model import Graph, Model
from dropper_jax.solvers.elimination import Order, apply, eliminate, elimination_order, solve

if TYPE_CHECKING:
    from scipy.sparse import csc_array

AnyArray = TypeVar("AnyArray", Array, np.ndarray)
Linear = Callable[[Array], Array]
#: A factored map: the displacements for given forces, or of the transposed map.
Solve = Callable[[Array, bool], Array]

#: Maximum number of corrections of a linear solve.
REFINEMENTS = 20
#: Remaining fraction of the right side above which a linear system has no solution.
UNSOLVABLE = 1e-7


@dataclass(frozen=True, eq=False)
class Tangent:
    """Layout of the blocks of K, which tell how nodal forces depend on nodes, and their elimination order.

    Attributes:
        row, column: nodes of each block (entries,), row by row.
        colour: of each column (free,); columns without a common row have the same one.
    """

    row: np.ndarray
    column: np.ndarray
    colour: np.ndarray
    order: Order

    @classmethod
    def of(cls, model: Model) -> Tangent:
        """That of a model's static forces."""
        return _tangent(model.geometry, max(model.reach, 1))

    @property
    def seeds(self) -> np.ndarray:
        """Displacements (colours, 3, free, 3) [m] of the nodes of one colour along one axis."""
        picked = self.colour == np.arange(1 + self.colour.max(initial=0))[:, None]
        return 1.0 * picked[:, None, :, None] * np.eye(3)[None, :, None, :]

    def blocks(self, answer: AnyArray) -> AnyArray:
        """Blocks (entries, 3, 3) [N/m], from the forces (colours, 3, free, 3) [N] that answer the seeds."""
        return answer[self.colour[self.column], :, self.row, :].swapaxes(-1, -2)

    def sparse(self, blocks: np.ndarray) -> csc_array:
        """The matrix (3 free, 3 free) [N/m] of these blocks."""
        from scipy.sparse import bsr_array  # noqa: PLC0415

        free = len(self.colour)
        starts = np.searchsorted(self.row, np.arange(free + 1))
        return bsr_array((blocks, self.column, starts), shape=(3 * free, 3 * free)).tocsc()

    def matrix(self, linear: Linear, x: Array) -> Array:
        """Blocks of a linear map from displacements like x to forces."""
        return self.blocks(jax.vmap(jax.vmap(linear))(jnp.asarray(self.seeds, x.dtype)))

    def dense(self, blocks: Array) -> Array:
        """The map as one matrix (3 free, 3 free)."""
        size = len(self.colour)
        matrix = jnp.zeros((size, 3, size, 3), blocks.dtype)
        return matrix.at[self.row, :, self.column, :].set(blocks).reshape(3 * size, 3 * size)

    def factor(self, linear: Linear, kappa: Array, x: Array) -> Solve:
        """The factored map of displacements like x, stiffened by kappa [N/m]."""
        own = jnp.asarray(self.row == self.column, x.dtype)
        stiffer = kappa * own[:, None, None] * jnp.eye(3, dtype=x.dtype)
        return self.factor_matrix(self.matrix(linear, x) + stiffer)

    def factor_matrix(self, blocks: Array) -> Solve:
        """The factored map of these blocks."""
        factor = eliminate(self.order, blocks)
        return lambda rows, transposed: solve(factor.transpose() if transposed else factor, rows)

    def multiply(self, blocks: Array, x: Array) -> Array:
        """The map of these blocks at displacements x (free, 3)."""
        return scatter_add_many(self.row, apply(blocks, x[self.column]), len(x))


@lru_cache(maxsize=64)
def _tangent(geometry: Graph, reach: int) -> Tangent:
    """That of forces that couple nodes up to this number of links apart."""
    from scipy.sparse import coo_array, eye_array  # noqa: PLC0415

    free = geometry.free
    inside = (geometry.first < free) & (geometry.last < free)
    links = geometry.first[inside], geometry.last[inside]
    linked = coo_array((np.ones(len(links[0])), links), shape=(free, free))
    neighbours = (linked + linked.T + eye_array(free)).tocsr()
    coupled = neighbours
    for _ in range(reach - 1):
        coupled = coupled @ neighbours
    common_row = (coupled.T @ coupled).tocsr()
    colour = np.full(free, -1)
    for node in range(free):
        taken = colour[common_row.indices[common_row.indptr[node] : common_row.indptr[node + 1]]]
        colour[node] = np.setdiff1d(np.arange(len(taken) + 1), taken)[0]
    entries = coupled.tocoo()
    order = elimination_order(free, list(zip(entries.row.tolist(), entries.col.tolist(), strict=True)))
    return Tangent(entries.row, entries.col, colour, order)


class DenseTangent:
    """The factored map for any coordinates (k,), as one matrix."""

    def matrix(self, linear: Linear, x: Array) -> Array:
        return jax.vmap(linear, out_axes=1)(jnp.eye(x.size, dtype=x.dtype))

    def dense(self, matrix: Array) -> Array:
        return matrix

    def factor(self, linear: Linear, kappa: Array, x: Array) -> Solve:
        factor = lu_factor(self.matrix(linear, x) + kappa * jnp.eye(x.size, dtype=x.dtype))
        return lambda rows, transposed: lu_solve(factor, rows, trans=int(transposed))


def solve_linear(tangent: Tangent | DenseTangent, kappa: Array, linear: Linear, right: Array) -> Array:
    """dr [m] with `linear(dr) = right` [N]; differentiable in both modes; NaN if there is no solution."""
    return _solve_factored(linear, tangent.factor(linear, kappa, right), right)


def solve_matrix(tangent: Tangent, matrix: Array, right: Array) -> Array:
    """The same for a matrix as blocks, real or complex, without free motions."""
    factor = tangent.factor_matrix(jax.lax.stop_gradient(matrix))
    return _solve_factored(partial(tangent.multiply, matrix), factor, right)


def _solve_factored(linear: Linear, factor: Solve, right: Array) -> Array:
    def solve_with(transposed: bool, matrix: Linear, b: Array) -> Array:
        return refine_solution(matrix, lambda left: factor(left, transposed), b)

    return jax.lax.custom_linear_solve(linear, right, partial(solve_with, False), partial(solve_with, True))


def refine_solution(matrix: Linear, apply: Linear, b: Array) -> Array:
    """x of `matrix(x) = b` by `x <- x + apply(b - matrix(x))`, until corrections no longer halve, or are rounding."""
    enough = 1e2 * jnp.finfo(b.dtype).eps

    def keep_iterating(carry: tuple[Array, ...]) -> Array:
        x, _, change, before, count = carry
        falling = (change < 0.5 * before) | (count < 2)
        return (change > enough * jnp.max(jnp.abs(x))) & falling & (count < REFINEMENTS)

    def correct(carry: tuple[Array, ...]) -> tuple[Array, ...]:
        x, left, change, _, count = carry
        dx = apply(left)
        x = x + dx
        return x, b - matrix(x), jnp.max(jnp.abs(dx)), change, count + 1

    never = jnp.full((), jnp.inf, jnp.finfo(b.dtype).dtype)
    x, left, *_ = jax.lax.while_loop(keep_iterating, correct, (jnp.zeros_like(b), b, never, never, jnp.zeros((), int)))
    return jnp.where(jnp.max(jnp.abs(left)) <= UNSOLVABLE * jnp.max(jnp.abs(b)), x, jnp.nan)
