"""Elimination of a system of lines, of which some do not stretch: tensions together with positions.

    A x + D'(G D x + p y) = r_x,    g . D x + c y = r_y        (c = 0 of rigid links; D takes differences over links)

Each inner node of a line is eliminated with the link before it, four unknowns. The last link of a line closes it. Its
tension is eliminated after the inner nodes of the line and a separate point at one of its ends, so that its pivot is
not zero. Where all links stretch, their tensions are eliminated first (`stretching`).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.model import Graph, Model
from dropper_jax.solvers.coupling import Coupling, coupled_pairs, most_neighbours
from dropper_jax.solvers.elimination import (
    Elimination,
    Order,
    Pair,
    eliminate,
    elimination_order,
    optimization_barrier,
    solve,
)
from dropper_jax.solvers.links import LinkParts
from dropper_jax.solvers.stretching import Stretching

#: Compliance of the last link of a line, relative to that of its points. It has an effect only for a straight line
#: between fixed points, which cannot move.
LAST_COMPLIANCE = 1e-10


class Saddle(NamedTuple):
    """The factored matrix: free nodes, an inner one with the link before it, and the lines' last links."""

    graph: Graph
    groups: Elimination

    @classmethod
    def of(cls, graph: Graph, node: Array, links: LinkParts, between: Coupling | None) -> Saddle:
        diagonal = node + graph.from_first(links.turn) + graph.from_last(links.turn)
        if graph.free:
            size = jnp.max(jnp.abs(diagonal))
        else:
            size = jnp.max(jnp.abs(links.turn)) + 1.0
        before = jax.tree.map(lambda part: part[graph.previous_links], links)
        last = jax.tree.map(lambda part: part[_last(graph)], links)
        none = jnp.zeros_like(last.turn)
        values = [
            _block(diagonal[: graph.inner], before.force, before.gradient, before.compliance),
            _block(diagonal[graph.inner :], corner=1.0),
            _block(none + jnp.eye(3, dtype=node.dtype), corner=last.compliance - LAST_COMPLIANCE / size),
            _block(-before.turn, below=-before.gradient),
            _block(-before.turn, right=-before.force),
            _block(-last.turn),
            _block(-last.turn),
            _block(none, right=-last.force),
            _block(none, below=-last.gradient),
            _block(none, right=last.force),
            _block(none, below=last.gradient),
        ]
        if between is not None:
            values.append(jnp.pad(optimization_barrier(between.blocks), ((0, 0), (0, 1), (0, 1))))
        return cls(graph, eliminate(_group_order(graph, coupled_pairs(between)), jnp.concatenate(values)))

    def transpose(self) -> Saddle:
        return self._replace(groups=self.groups.transpose())

    def solve(self, force: Array, stretch: Array) -> tuple[Array, Array]:
        """Displacements (free, 3) and tensions (n,) for r_x = `force`, r_y = `stretch`."""
        graph = self.graph
        last = _last(graph)
        points = len(graph.free_points)
        own = jnp.concatenate([stretch[graph.previous_links], jnp.zeros((points,), force.dtype), stretch[last]])
        moved = jnp.concatenate([force, jnp.zeros((len(last), 3), force.dtype)])
        found = solve(self.groups, jnp.concatenate([moved, own[:, None]], axis=-1))
        number = np.empty(graph.links, int)
        number[graph.previous_links] = np.arange(graph.inner)
        number[last] = graph.free + np.arange(len(last))
        return found[: graph.free, :3], found[number, 3]


def _block(
    top: Array,
    right: Array | float = 0.0,
    below: Array | float = 0.0,
    corner: Array | float = 0.0,
) -> Array:
    """Blocks (m, 4, 4) of forces (m, 3, 3), (m, 3) by a tension, and its own row (m, 3), (m,)."""
    row = jnp.zeros_like(top[:, 0])
    upper = jnp.concatenate([top, (row + right)[..., None]], axis=-1)
    lower = jnp.concatenate([row + below, (row[:, :1] + jnp.reshape(corner, (-1, 1)))], axis=-1)
    return jnp.concatenate([upper, lower[:, None]], axis=1)


def _last(graph: Graph) -> np.ndarray:
    """The last link of each line."""
    return np.array([span.stop - 1 for span in graph.spans])


def factor_lines(
    model: Model, graph: Graph, node: Array, links: LinkParts, between: Coupling | None
) -> Stretching | Saddle:
    """The factored matrix from A = `node` (free, 3, 3), the parts of the links, and the blocks of elements."""
    if model.line.axial.elastic:
        return Stretching.of(graph, node, links, between)
    return Saddle.of(graph, node, links, between)


@lru_cache(maxsize=64)
def _group_order(graph: Graph, between: tuple[Pair, ...]) -> Order:
    """The order for blocks as in `Saddle.of`: groups are the free nodes, then the last links of lines."""
    count = graph.free + len(graph.members)

    def number(nodes: np.ndarray) -> list[int]:
        """Groups of nodes; fixed nodes have none."""
        return np.where(nodes < graph.free, nodes, count).tolist()

    own = list(range(count))
    closing = list(range(graph.free, count))
    inner = list(range(graph.inner))
    first = number(graph.first[graph.previous_links])
    start = number(graph.first[_last(graph)])
    end = number(graph.last[_last(graph)])
    sides = [(own, own), (inner, first), (first, inner), (start, end), (end, start)]
    sides += [(start, closing), (closing, start), (end, closing), (closing, end)]
    pairs: list[Pair] = []
    for rows, columns in sides:
        pairs += zip(rows, columns, strict=True)
    return elimination_order(
        count, [*pairs, *between], find_nodes_before_last_link(graph), most=most_neighbours(between)
    )


def find_nodes_before_last_link(graph: Graph) -> dict[int, set[int]]:
    """Nodes eliminated before the last link of each line: its inner nodes, and a point at one end that is not used by
    another.

    Both ends where there are more lines than points.
    """
    free = []
    for path in graph.paths:
        free.append({int(path[i]) for i in (0, -1) if path[i] < graph.free})
    owner: dict[int, int] = {}
    for line in range(len(free)):
        _assign_owner(line, free, owner)
    point_of = {line: {point} for point, line in owner.items()}
    before = {}
    for i, path in enumerate(graph.paths):
        before[graph.free + i] = set(map(int, path[1:-1])) | point_of.get(i, free[i])
    return before


def _assign_owner(line: int, free: list[set[int]], owner: dict[int, int]) -> None:
    """Give a line one of its points; along an augmenting path the owners of points move on to others of theirs.

    Without recursion: a path through many lines is deeper than Python's stack.

    Args:
        free: points of each line.
        owner: line of each point that has one; changed in place.
    """
    visited: set[int] = set()
    path = [(line, iter(free[line] - visited))]
    taken: list[int] = []  # the point that each line of the path is to own
    while path:
        point = next(path[-1][1], None)
        del taken[len(path) - 1 :]
        if point is None:
            path.pop()
            continue
        visited.add(point)
        taken.append(point)
        if point not in owner:
            for (new, _), own in zip(path[::-1], taken[::-1], strict=True):
                owner[own] = new
            return
        path.append((owner[point], iter(free[owner[point]] - visited)))
