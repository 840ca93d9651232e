"""Blocks of forces between nodes, such as contact and bending: rows of one node by the unknowns of another."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.indexed_sums import scatter_add_many
from dropper_jax.model import ElementForce, at_pieces
from dropper_jax.residual import StepProblem, Unknowns
from dropper_jax.solvers.elimination import ALONG_LINES, WIDER, Pair


class Coupling(NamedTuple):
    """Blocks (k, 3, 3) of the rows of one node by the unknowns of another, and their (row, column)."""

    pairs: tuple[Pair, ...]
    blocks: Array

    def transpose(self) -> Coupling:
        return Coupling(tuple((column, row) for row, column in self.pairs), self.blocks.mT)


def coupled_pairs(between: Coupling | None) -> tuple[Pair, ...]:
    """The nodes that elements couple in addition to links."""
    if between is None:
        return ()
    return between.pairs


def most_neighbours(between: tuple[Pair, ...]) -> int:
    """Maximum number of neighbours of nodes in one round (see `elimination_order`)."""
    if between:
        return WIDER
    return ALONG_LINES


def coupling(problem: StepProblem, u: Unknowns) -> Coupling | None:
    """Exact, from three directions of forward mode for each node of an element; None without elements."""
    found = [_element_blocks(problem, u, effect) for effect in problem.pieces]
    if not found:
        return None
    return Coupling(sum((c.pairs for c in found), ()), jnp.concatenate([c.blocks for c in found]))


def _element_blocks(problem: StepProblem, u: Unknowns, effect: ElementForce) -> Coupling:
    model = problem.model
    k = problem.instant(u.x)
    graph = model.geometry
    nodes = effect.piece_nodes(model)

    def where(x: Array) -> tuple[Array, Array]:
        at = problem.instant(x)
        return at.r, at.v

    # derivatives of positions and velocities by the unknowns
    follows = jax.jvp(where, (u.x,), (jnp.ones_like(u.x),))[1]
    r, v = at_pieces(k, nodes)
    turn_r = graph.everywhere(follows[0], None)[nodes]
    turn_v = graph.everywhere(follows[1], None)[nodes]

    def rows(x: Array) -> Array:
        return -effect.piece_force(k, r + turn_r * x, v + turn_v * x)

    each = nodes.shape[1]
    unit = jnp.eye(3 * each, dtype=r.dtype).reshape(-1, 1, each, 3)
    zero = jnp.zeros_like(r)
    columns = jax.vmap(lambda e: jax.jvp(rows, (zero,), (jnp.broadcast_to(e, r.shape),))[1], out_axes=-1)(unit)
    blocks = jnp.moveaxis(columns.reshape(len(nodes), each, 3, each, 3), 3, 2).reshape(-1, 3, 3)
    return _sum_blocks(nodes, blocks, graph.free)


def _sum_blocks(nodes: np.ndarray, blocks: Array, free: int) -> Coupling:
    """Sum of blocks of the same two nodes; those of fixed points are left out."""
    each = nodes.shape[1]
    row = np.broadcast_to(nodes[:, :, None], (len(nodes), each, each)).ravel()
    column = np.broadcast_to(nodes[:, None, :], (len(nodes), each, each)).ravel()
    free_pairs = np.flatnonzero((row < free) & (column < free))
    codes, where = np.unique(row[free_pairs] * free + column[free_pairs], return_inverse=True)
    pairs = tuple(zip((codes // free).tolist(), (codes % free).tolist(), strict=True))
    return Coupling(pairs, scatter_add_many(where, blocks[free_pairs], len(codes)))
