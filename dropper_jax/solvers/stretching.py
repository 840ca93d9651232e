"""Elimination of a system of lines that all stretch: tensions first, which leaves the free nodes.

A x + D'(G D x + p y) = r_x,    g . D x + c y = r_y        (c < 0 in every link; D takes differences over links)
y = (r_y - g . D x)/c,    (A + D'(G - p g'/c) D) x = r_x - D' p r_y/c
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from dropper_jax.model import Graph
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


class Stretching(NamedTuple):
    """The factored matrix for elastic links only: tensions are eliminated first."""

    graph: Graph
    links: LinkParts
    nodes: Elimination

    @classmethod
    def of(cls, graph: Graph, node: Array, links: LinkParts, between: Coupling | None) -> Stretching:
        stiffness = links.turn - (links.force / links.compliance[:, None])[..., None] * links.gradient[:, None, :]
        diagonal = node + graph.from_first(stiffness) + graph.from_last(stiffness)
        blocks = jnp.concatenate([diagonal, -stiffness, -stiffness])
        if between is not None:
            blocks = jnp.concatenate([blocks, optimization_barrier(between.blocks)])
        return cls(graph, links, eliminate(_node_order(graph, coupled_pairs(between)), blocks))

    def transpose(self) -> Stretching:
        return self._replace(links=self.links.transpose(), nodes=self.nodes.transpose())

    def solve(self, force: Array, stretch: Array) -> tuple[Array, Array]:
        """Displacements (free, 3) and tensions (n,) for r_x = `force`, r_y = `stretch`."""
        graph = self.graph
        _, link_force, gradient, compliance = self.links
        x = solve(self.nodes, force + graph.gather((stretch / compliance)[:, None] * link_force))
        return x, (stretch - jnp.sum(gradient * graph.differences(x, None), axis=-1)) / compliance


@lru_cache(maxsize=64)
def _node_order(graph: Graph, between: tuple[Pair, ...]) -> Order:
    """The order for the blocks of the free nodes, of links from first to last node, and from last to first, and of
    elements."""
    own = range(graph.free)
    first = graph.first.tolist()
    last = graph.last.tolist()
    pairs = [*zip(own, own, strict=True), *zip(first, last, strict=True), *zip(last, first, strict=True)]
    return elimination_order(graph.free, [*pairs, *between], most=most_neighbours(between))
