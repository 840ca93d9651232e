"""Elimination of a system of lines with elastic links only: first tensions, then all nodes by rounds."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.model import Graph
from dropper_jax.solvers.blocks import optimization_barrier
from dropper_jax.solvers.elimination import Elimination, eliminate, solve
from dropper_jax.solvers.order import WIDER, Order, Pair, elimination_order
from dropper_jax.solvers.pieces import Coupling
from dropper_jax.solvers.saddle import LinkParts


class Stretching(NamedTuple):
    """The factored matrix for elastic links only: tensions are eliminated first."""

    graph: Graph
    links: LinkParts
    nodes: Elimination

    @classmethod
    def of(cls, graph: Graph, node: jax.Array, links: LinkParts, between: Coupling | None = None) -> Stretching:
        """From A = `node` (free, 3, 3), and its off-diagonal blocks."""
        ratio = links.force / links.compliance[:, None]
        stiffness = links.turn - ratio[..., None] * links.gradient[:, None, :]
        diagonal = node + graph.from_first(stiffness) + graph.from_last(stiffness)
        blocks = jnp.concatenate([diagonal, -stiffness, -stiffness])
        if between is None:
            return cls(graph, links, eliminate(_node_order(graph), blocks))
        blocks = jnp.concatenate([blocks, optimization_barrier(between.blocks)])
        return cls(graph, links, eliminate(_node_order(graph, between.pairs), blocks))

    def transpose(self) -> Stretching:
        return self._replace(links=self.links.transpose(), nodes=self.nodes.transpose())

    def solve(self, force: jax.Array, stretch: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Displacements (free, 3) and tensions (n,) for r_x = `force`, r_y = `stretch`."""
        graph, (_, link_force, gradient, compliance) = self.graph, self.links
        x = solve(self.nodes, force + graph.gather((stretch / compliance)[:, None] * link_force))
        return x, (stretch - jnp.sum(gradient * graph.differences(x, None), axis=-1)) / compliance


@lru_cache(maxsize=64)
def _node_order(graph: Graph, between: tuple[Pair, ...] = ()) -> Order:
    """The order for the blocks of the free nodes, of links from first to last node, and from last to first."""
    own, first, last = range(graph.free), graph.first.tolist(), graph.last.tolist()
    pairs = [*zip(own, own, strict=True), *zip(first, last, strict=True), *zip(last, first, strict=True)]
    return elimination_order(graph.free, [*pairs, *between], most=WIDER if between else 2)
