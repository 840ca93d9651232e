"""Distribution of water forces: which part of a link acts on which node, and its submerged fraction.

A link's water forces are distributed to its nodes as its mass is: all to its far node for point-mass links, according
to the centre of mass for compound ones. A node's part is submerged if the surface is above it, smoothly over the height
of the link there: `w = s^2 (3 - 2 s)`, `s = 1/2 + (eta - z)/(D + L |q_z|)` between 0 and 1, q the link's direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp


class Part:
    """One share of the links' water forces: the rows on which it is computed, and the mapping from and to the free
    nodes.

    Attributes:
        share: the fraction of a link's force, a number or (rows,).
    """

    share: jax.Array | float

    def take(self, per_link: jax.Array) -> jax.Array:
        """Values (n, ...) of the links, one per row; a number stays one."""
        raise NotImplementedError

    def at(self, nodal: jax.Array) -> jax.Array:
        """Values (nodes, ...) of the free nodes, one per row."""
        raise NotImplementedError

    def collect(self, rows: jax.Array) -> jax.Array:
        """Sum of the rows on the free nodes (nodes, ...)."""
        raise NotImplementedError


@dataclass(frozen=True)
class PathPart(Part):
    """For one line: the rows are its free nodes, each taken from one link."""

    share: jax.Array | float
    first: int
    nodes: int

    def take(self, per_link: jax.Array) -> jax.Array:
        if jnp.ndim(per_link) == 0:
            return per_link
        taken = per_link[self.first : self.first + self.nodes]
        lacking = self.nodes - taken.shape[0]
        return jnp.concatenate([taken, jnp.zeros_like(per_link[:lacking])]) if lacking else taken

    def at(self, nodal: jax.Array) -> jax.Array:
        return nodal

    def collect(self, rows: jax.Array) -> jax.Array:
        return rows

    def spread(self, per_node: jax.Array, links: int) -> jax.Array:
        """The transpose of `take`: values of the nodes (nodes, 3) on their links (n, 3)."""
        kept = per_node[: links - self.first]
        after = links - self.first - kept.shape[0]
        return jnp.pad(kept, ((self.first, after), (0, 0)))
