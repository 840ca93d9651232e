"""Tangent stiffness of an equilibrium: its blocks, and linear solves with it inside a compiled program.

    K = -dF/dr,    K dr = dF        (F: all static forces on free nodes, including the tensions of links)

K is exact: it includes drag that turns with the links, contact and wetted fractions. Its blocks come from a handful of
directional derivatives (see `pattern`) and are eliminated in rounds (`solvers.elimination`) in O(n). If a node can move
freely K is singular: `K + kappa` is eliminated, and the solution is refined with K itself. This gives the shortest
solution, or NaN if the system has no solution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.linalg import lu_factor, lu_solve

from dropper_jax.base.indexed_sums import scatter_add_many
from dropper_jax.model import Graph, Model, State, state
from dropper_jax.solvers.elimination import Order, apply, eliminate, elimination_order, solve
from dropper_jax.statics.pattern import Pattern, pattern
from dropper_jax.statics.rest_problem import SMALLEST, balanced, soft_scale, unbalanced_at

Linear = Callable[[Array], Array]
#: A factored map: the displacements for given forces, or of the transposed map.
Solve = Callable[[Array, bool], Array]

#: Maximum number of corrections of a linear solve, and the remaining fraction of the right side above which the system
#: has no solution.
REFINEMENTS = 20
LEFT = 1e-7


@lru_cache(maxsize=64)
def _order(geometry: Graph, reach: int) -> Order:
    near = pattern(geometry, reach)
    return elimination_order(geometry.free, list(zip(near.row.tolist(), near.column.tolist(), strict=True)))


@dataclass(frozen=True)
class Tangent:
    """Layout and elimination order of the blocks of a model's K."""

    pattern: Pattern
    order: Order
    kappa: Array

    @classmethod
    def of(cls, model: Model) -> Tangent:
        reach = max(model.reach, 1)
        kappa = SMALLEST * soft_scale(model)
        return cls(pattern(model.geometry, reach), _order(model.geometry, reach), jax.lax.stop_gradient(kappa))

    def matrix(self, linear: Linear, x: Array) -> Array:
        """Blocks (entries, 3, 3) [N/m] of a linear map from displacements like x to forces, in the order of the
        pattern."""
        seeds = jnp.asarray(self.pattern.seeds, x.dtype)
        return self.pattern.blocks(jax.vmap(jax.vmap(linear))(seeds))

    def dense(self, blocks: Array) -> Array:
        """The map as one matrix (3 free, 3 free)."""
        row = self.pattern.row
        column = self.pattern.column
        size = len(self.pattern.colour)
        matrix = jnp.zeros((size, 3, size, 3), blocks.dtype)
        return matrix.at[row, :, column, :].set(blocks).reshape(3 * size, 3 * size)

    def factor(self, linear: Linear, kappa: Array, x: Array) -> Solve:
        """The factored map of displacements like x, stiffened by kappa [N/m]."""
        own = jnp.asarray(self.pattern.row == self.pattern.column, x.dtype)
        stiffer = kappa * own[:, None, None] * jnp.eye(3, dtype=x.dtype)
        return self.factor_matrix(self.matrix(linear, x) + stiffer)

    def factor_matrix(self, blocks: Array) -> Solve:
        """The factored map of these blocks."""
        factor = eliminate(self.order, blocks)
        return lambda rows, transposed: solve(factor.transpose() if transposed else factor, rows)

    def multiply(self, blocks: Array, x: Array) -> Array:
        """The map of these blocks at displacements x (free, 3)."""
        return scatter_add_many(self.pattern.row, apply(blocks, x[self.pattern.column]), len(x))


@dataclass(frozen=True)
class DenseTangent:
    """The factored map for any coordinates (k,), as one matrix."""

    kappa: Array

    def matrix(self, linear: Linear, x: Array) -> Array:
        return jax.vmap(linear, out_axes=1)(jnp.eye(x.size, dtype=x.dtype))

    def dense(self, matrix: Array) -> Array:
        return matrix

    def factor(self, linear: Linear, kappa: Array, x: Array) -> Solve:
        factor = lu_factor(self.matrix(linear, x) + kappa * jnp.eye(x.size, dtype=x.dtype))
        return lambda rows, transposed: lu_solve(factor, rows, trans=int(transposed))


def solve_linear(tangent: Tangent | DenseTangent, linear: Linear, right: Array) -> Array:
    """dr [m] with `linear(dr) = right` [N]; differentiable in both modes; NaN if there is no solution."""
    return _solve_factored(linear, tangent.factor(linear, tangent.kappa, right), right)


def solve_matrix(tangent: Tangent, matrix: Array, right: Array) -> Array:
    """The same for a matrix as blocks, real or complex, without free motions."""
    factor = tangent.factor_matrix(jax.lax.stop_gradient(matrix))
    return _solve_factored(partial(tangent.multiply, matrix), factor, right)


def _solve_factored(linear: Linear, factor: Solve, right: Array) -> Array:
    def solve_with(transposed: bool, matrix: Linear, b: Array) -> Array:
        return refine_solution(matrix, lambda left: factor(left, transposed), b)

    return jax.lax.custom_linear_solve(linear, right, partial(solve_with, False), partial(solve_with, True))


def refine_solution(matrix: Linear, apply: Linear, b: Array) -> Array:
    """x of `matrix(x) = b` by `x <- x + apply(b - matrix(x))`, until the residual no longer decreases."""
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
    return jnp.where(jnp.max(jnp.abs(left)) <= LEFT * jnp.max(jnp.abs(b)), x, jnp.nan)


@dataclass(frozen=True)
class NodeMoves:
    """Displacements x (free, 3) [m] of the nodes of elastic lines as the unknowns of an equilibrium."""

    model: Model

    @property
    def tangent(self) -> Tangent:
        return Tangent.of(self.model)

    @property
    def none(self) -> Array:
        """x of the reference configuration of the displacements."""
        return jnp.zeros((self.model.free_nodes, 3), self.model.dtype)

    def rows(self, s: State, loads: Array, x: Array) -> Array:
        """Unbalanced forces [N], minus F, at the displacement x from s."""
        return unbalanced_at(self.model, s, loads, x)[0]

    def move_pose(self, s: State, loads: Array, x: Array) -> State:
        """The configuration at the displacement x from s."""
        return balanced(self.model, state(self.model, s.r + x, t=s.t), loads)
