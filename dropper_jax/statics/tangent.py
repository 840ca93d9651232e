"""Tangent stiffness of an equilibrium: its blocks, and linear solves with it inside a compiled program.

    K = -dF/dr,    K dr = dF        (F: all static forces on free nodes, including the tensions of links)

K is exact: it includes drag that turns with the links, contact and wetted fractions. Its blocks come from a handful of
directional derivatives (nodes without a common row use the same
one) and are eliminated in rounds (`solvers.elimination`)
in O(n). If a node can move freely K is singular: `K + kappa` is eliminated, and the solution is refined with K itself.
This gives the shortest solution, or NaN if the system has no solution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import lu_factor, lu_solve

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.indexed_sums import scatter_add_many
from dropper_jax.model import Graph, Model, State, state
from dropper_jax.solvers.elimination import Elimination, Order, apply, eliminate, elimination_order, solve
from dropper_jax.statics.rest_problem import SMALLEST, balanced, name_of, rest, soft_scale, unbalanced_at

if TYPE_CHECKING:
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import SuperLU

Linear = Callable[[jax.Array], jax.Array]
#: Factors of a dense matrix.
LU = tuple[jax.Array, jax.Array]
Array = TypeVar("Array", jax.Array, np.ndarray)
Tree = TypeVar("Tree")

#: Maximum number of corrections of a linear solve, and the remaining fraction of the right side above which the system
#: has no solution.
REFINEMENTS = 20
LEFT = 1e-7


class Pattern(NamedTuple):
    """Dependence of nodal forces on nodes: entries (row, column), and a colour (free,) of each column."""

    row: np.ndarray
    column: np.ndarray
    colour: np.ndarray
    colours: int

    @property
    def seeds(self) -> np.ndarray:
        """Displacements (colours, 3, free, 3) [m] of the nodes of one colour along one axis."""
        picked = self.colour == np.arange(self.colours)[:, None]
        return 1.0 * picked[:, None, :, None] * np.eye(3)[None, :, None, :]

    def blocks(self, answer: Array) -> Array:
        """Blocks (entries, 3, 3) [N/m], from the forces (colours, 3, free, 3) [N] that answer the seeds."""
        return answer[self.colour[self.column], :, self.row, :].swapaxes(-1, -2)

    def sparse(self, blocks: np.ndarray) -> csc_array:
        """The matrix (3 free, 3 free) [N/m] of these blocks."""
        from scipy.sparse import csc_array  # noqa: PLC0415

        axis = np.arange(3)
        rows = np.broadcast_to(3 * self.row[:, None, None] + axis[:, None], blocks.shape)
        columns = np.broadcast_to(3 * self.column[:, None, None] + axis, blocks.shape)
        size = 3 * len(self.colour)
        return csc_array((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size))


@lru_cache(maxsize=64)
def pattern(geometry: Graph, reach: int) -> Pattern:
    """Pattern of forces that couple nodes up to this number of links apart; columns without a common row have the same
    colour."""
    from scipy.sparse import coo_array, eye_array  # noqa: PLC0415

    free = geometry.free
    first = np.concatenate([path[slice(-1)] for path in geometry.paths])
    last = np.concatenate([path[slice(1, None)] for path in geometry.paths])
    inside = (first >= 0) & (first < free) & (last < free)
    first = first[inside]
    last = last[inside]
    beside = coo_array((np.ones(len(first)), (first, last)), shape=(free, free))
    near = (beside + beside.T + eye_array(free)).tocsr()
    far = near
    for _ in range(reach - 1):
        far = far @ near
    meeting = (far.T @ far).tocsr()
    colour = np.full(free, -1)
    for node in range(free):
        taken = colour[meeting.indices[meeting.indptr[node] : meeting.indptr[node + 1]]]
        colour[node] = np.setdiff1d(np.arange(len(taken) + 1), taken)[0]
    entries = far.tocoo()
    return Pattern(entries.row, entries.col, colour, int(colour.max(initial=0)) + 1)


def pattern_of(model: Model) -> Pattern:
    """The pattern of a model's static forces."""
    return pattern(model.geometry, max(model.reach, 1))


@lru_cache(maxsize=64)
def _order(geometry: Graph, reach: int) -> Order:
    near = pattern(geometry, reach)
    return elimination_order(geometry.free, list(zip(near.row.tolist(), near.column.tolist(), strict=True)))


@dataclass(frozen=True)
class Tangent:
    """Layout and elimination order of the blocks of a model's K."""

    pattern: Pattern
    order: Order
    kappa: jax.Array

    @classmethod
    def of(cls, model: Model) -> Tangent:
        reach = max(model.reach, 1)
        kappa = SMALLEST * soft_scale(model)
        return cls(pattern(model.geometry, reach), _order(model.geometry, reach), jax.lax.stop_gradient(kappa))

    def matrix(self, linear: Linear, x: jax.Array) -> jax.Array:
        """Blocks (entries, 3, 3) [N/m] of a linear map from displacements like x to forces, in the order of the
        pattern."""
        seeds = jnp.asarray(self.pattern.seeds, x.dtype)
        return self.pattern.blocks(jax.vmap(jax.vmap(linear))(seeds))

    def dense(self, blocks: jax.Array) -> jax.Array:
        """The map as one matrix (3 free, 3 free)."""
        row = self.pattern.row
        column = self.pattern.column
        size = len(self.pattern.colour)
        matrix = jnp.zeros((size, 3, size, 3), blocks.dtype)
        return matrix.at[row, :, column, :].set(blocks).reshape(3 * size, 3 * size)

    def factor(self, linear: Linear, kappa: jax.Array, x: jax.Array) -> Elimination:
        """The factored map of displacements like x, stiffened by kappa [N/m]."""
        own = jnp.asarray(self.pattern.row == self.pattern.column, x.dtype)
        stiffer = kappa * own[:, None, None] * jnp.eye(3, dtype=x.dtype)
        return self.factor_matrix(self.matrix(linear, x) + stiffer)

    def factor_matrix(self, blocks: jax.Array) -> Elimination:
        """The factored map of these blocks."""
        return eliminate(self.order, blocks)

    def multiply(self, blocks: jax.Array, x: jax.Array) -> jax.Array:
        """The map of these blocks at displacements x (free, 3)."""
        return scatter_add_many(self.pattern.row, apply(blocks, x[self.pattern.column]), len(x))

    def apply(self, factor: Elimination, rows: jax.Array, transposed: bool = False) -> jax.Array:
        """The displacements for given forces."""
        return solve(factor.transpose() if transposed else factor, rows)


@dataclass(frozen=True)
class DenseTangent:
    """The factored map for any coordinates (k,), as one matrix."""

    kappa: jax.Array

    def matrix(self, linear: Linear, x: jax.Array) -> jax.Array:
        return jax.vmap(linear, out_axes=1)(jnp.eye(x.size, dtype=x.dtype))

    def dense(self, matrix: jax.Array) -> jax.Array:
        return matrix

    def factor(self, linear: Linear, kappa: jax.Array, x: jax.Array) -> LU:
        return lu_factor(self.matrix(linear, x) + kappa * jnp.eye(x.size, dtype=x.dtype))

    def apply(self, factor: LU, rows: jax.Array, transposed: bool = False) -> jax.Array:
        return lu_solve(factor, rows, trans=int(transposed))


def solve_linear(tangent: Tangent | DenseTangent, linear: Linear, right: jax.Array) -> jax.Array:
    """dr [m] with `linear(dr) = right` [N]; differentiable in both modes; NaN if there is no solution."""
    return _solve_factored(tangent, linear, tangent.factor(linear, tangent.kappa, right), right)


def solve_matrix(tangent: Tangent, matrix: jax.Array, right: jax.Array) -> jax.Array:
    """The same for a matrix as blocks, real or complex, without free motions."""
    factor = tangent.factor_matrix(jax.lax.stop_gradient(matrix))
    return _solve_factored(tangent, partial(tangent.multiply, matrix), factor, right)


def _solve_factored(
    tangent: Tangent | DenseTangent, linear: Linear, factor: Elimination | LU, right: jax.Array
) -> jax.Array:
    def solve_with(transposed: bool, matrix: Linear, b: jax.Array) -> jax.Array:
        return refine_solution(matrix, partial(tangent.apply, factor, transposed=transposed), b)

    return jax.lax.custom_linear_solve(linear, right, partial(solve_with, False), partial(solve_with, True))


def refine_solution(matrix: Linear, apply: Linear, b: jax.Array) -> jax.Array:
    """x of `matrix(x) = b` by `x <- x + apply(b - matrix(x))`, until the residual no longer decreases."""
    enough = 1e2 * jnp.finfo(b.dtype).eps

    def keep_iterating(carry: tuple[jax.Array, ...]) -> jax.Array:
        x, _, change, before, count = carry
        falling = (change < 0.5 * before) | (count < 2)
        return (change > enough * jnp.max(jnp.abs(x))) & falling & (count < REFINEMENTS)

    def correct(carry: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        x, left, change, _, count = carry
        dx = apply(left)
        x = x + dx
        return x, b - matrix(x), jnp.max(jnp.abs(dx)), change, count + 1

    never = jnp.full((), jnp.inf, jnp.finfo(b.dtype).dtype)
    x, left, *_ = jax.lax.while_loop(keep_iterating, correct, (jnp.zeros_like(b), b, never, never, jnp.zeros((), int)))
    return jnp.where(jnp.max(jnp.abs(left)) <= LEFT * jnp.max(jnp.abs(b)), x, jnp.nan)


def follow_parameters(
    model: Model, count: int, slopes: Callable[[np.ndarray, np.ndarray], tuple[jax.Array, Tree]]
) -> tuple[Tree, np.ndarray]:
    """Derivatives of an equilibrium by `count` parameters, `dx = -K^-1 dR/dp`, solved on the host.

    Args:
        slopes: derivatives of the unbalanced forces R (k, free, 3) [N] and of a tree along k directions of parameters
            (k, count) and positions (k, free, 3) [m]. One program serves K and R.

    Returns:
        the tree, whose last `count` directions are those of the parameters, and where there is no solution (count,).
    """
    near = pattern_of(model)
    by_position = np.concatenate([near.seeds.reshape(-1, model.free_nodes, 3), np.zeros((count, model.free_nodes, 3))])
    by_value = np.concatenate([np.zeros((len(by_position) - count, count)), np.eye(count)])
    rows, found = slopes(by_value, by_position)
    blocks = near.blocks(np.asarray(rows[:-count]).reshape(near.colours, 3, -1, 3))
    factor = factor_softened(model, near.sparse(blocks))
    right = rows[-count:]
    for _ in range(2):  # the second correction reduces the rounding error, and the error by the softening
        dx = factor.solve(np.asarray(rows[-count:]).reshape(count, -1).T)
        by_position[-count:] -= dx.T.reshape(count, -1, 3)
        rows, found = slopes(by_value, by_position)
    left = np.max(np.abs(rows[-count:]), axis=(1, 2))
    size = np.max(np.abs(right), axis=(1, 2))
    return found, left > LEFT * size


@dataclass(frozen=True)
class NodeMoves:
    """Displacements x (free, 3) [m] of the nodes of elastic lines as the unknowns of an equilibrium."""

    model: Model

    @property
    def tangent(self) -> Tangent:
        return Tangent.of(self.model)

    @property
    def none(self) -> jax.Array:
        """x of the reference configuration of the displacements."""
        return jnp.zeros((self.model.free_nodes, 3), self.model.dtype)

    def rows(self, s: State, loads: jax.Array, x: jax.Array) -> jax.Array:
        """Unbalanced forces [N], minus F, at the displacement x from s."""
        return unbalanced_at(self.model, s, loads, x)[0]

    def move_pose(self, s: State, loads: jax.Array, x: jax.Array) -> State:
        """The configuration at the displacement x from s."""
        return balanced(self.model, state(self.model, s.r + x, t=s.t), loads)


def stiffness_matrix(moves: NodeMoves, s: State, loads: jax.Array) -> jax.Array:
    """K at a configuration in the form of its unknowns: blocks, or one matrix."""
    return moves.tangent.matrix(jax.linearize(partial(moves.rows, s, loads), moves.none)[1], moves.none)


@cached_jit()
def _blocks(model: Model, s: State, loads: jax.Array) -> jax.Array:
    return stiffness_matrix(NodeMoves(model), s, loads)


def stiffness(model: Model, s: State, loads: jax.Array) -> csc_array:
    """Minus the derivative of all forces by all positions (3 free, 3 free) [N/m], including drag and contact. On the
    host."""
    return pattern_of(model).sparse(np.asarray(_blocks(model, s, loads)))


def factor_softened(model: Model, matrix: csc_array) -> SuperLU:
    """Factors of a stiffness, a little stiffer, so that it need not be regular. On the host."""
    from scipy.sparse import eye_array  # noqa: PLC0415
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    return splu((matrix + SMALLEST * float(soft_scale(model, np)) * eye_array(matrix.shape[0])).tocsc())


def softest_motion(model: Model, s: State, loads: jax.Array) -> tuple[float, np.ndarray]:
    """Minimum stiffness [N/m] of an equilibrium and its motion (free, 3), maximum 1. On the host.

    It does not raise: an equilibrium with a free motion has the stiffness 0 to rounding.
    """
    matrix = stiffness(model, s, loads)
    factor = factor_softened(model, matrix)
    x = np.random.default_rng(0).normal(size=matrix.shape[0])
    # number of inverse iterations for the softest motion; of several soft ones any may result
    for _ in range(12):
        x = factor.solve(x / np.linalg.norm(x))
    x /= np.linalg.norm(x)
    way = x.reshape(-1, 3)
    return float(np.linalg.norm(matrix @ x)), way / np.max(np.abs(way))


def free_motion(model: Model, s: State, loads: jax.Array) -> str:
    """A note on the node that can move freely about an equilibrium; empty without any, and for inextensible links."""
    model = rest(model)
    if model.constraints or not model.line.axial.elastic:
        return ""
    least, way = softest_motion(model, s, loads)
    # stiffness, over the weight of a link per its length, below which a motion counts as free
    if least > 1e-7 * float(soft_scale(model, np)):
        return ""
    node = int(np.argmax(np.max(np.abs(way), axis=1)))
    along = ", ".join(f"{x:.2f}" for x in way[node])
    return f"{name_of(model, node)} is unconstrained along ({along}), with a stiffness of {least:.1e} N/m"
