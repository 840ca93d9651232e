"""One line between two points as a path of nodes, each link's mass and forces on its far node.

Node j = 1..n is the far node of link j; free nodes are 1..n, or 1..n - 1 if the end is fixed.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.model.geometry import Geometry, Member
from dropper_jax.model.shares import Part, PathPart


def link_differences(free: jax.Array, held: jax.Array | None, ends: int) -> jax.Array:
    """Differences over the links (n, ...) of a nodal field, `ends` of whose ends are fixed; without values at zero."""
    if held is None:
        held = jnp.zeros((ends, *free.shape[1:]), free.dtype)
    if ends == 1:
        return free - jnp.concatenate([held, free[:-1]])
    return jnp.concatenate([free, held[1:]]) - jnp.concatenate([held[:1], free])


def gather_links(link_force: jax.Array, ends: int) -> jax.Array:
    """Sum on the free nodes (nodes, ...) of the links' tension forces (n, ...): + on their first node, - on their
    last."""
    if ends == 2:
        return link_force[1:] - link_force[:-1]
    return jnp.concatenate([link_force[1:], jnp.zeros_like(link_force[:1])]) - link_force


@dataclass(frozen=True)
class Path(Geometry):
    """A single line from a fixed point.

    Attributes:
        members: the one line.
        held: whether its two points are fixed; the first is.
    """

    members: tuple[Member]
    held: tuple[bool, bool] = (True, True)

    @property
    def held_points(self) -> np.ndarray:
        member = self.members[0]
        return np.array([member.start, member.end])[list(self.held)]

    @property
    def free(self) -> int:
        return self.links + 1 - self.ends

    @property
    def paths(self) -> tuple[np.ndarray, ...]:
        return (np.arange(-1, self.links),)

    def nodes(self, free: jax.Array, held: jax.Array) -> jax.Array:
        return jnp.concatenate([held[:1], free, held[1:]])

    def differences(self, free: jax.Array, held: jax.Array | None) -> jax.Array:
        return link_differences(free, held, self.ends)

    def gather(self, link_force: jax.Array) -> jax.Array:
        return gather_links(link_force, self.ends)

    def held_force(self, link_force: jax.Array) -> jax.Array:
        return jnp.stack([link_force[0], -link_force[-1]][: self.ends])

    def share_to_nodes(self, value: jax.Array) -> jax.Array:
        return value[: self.free]

    def parts(self) -> tuple[Part, ...]:
        return (PathPart(1.0, 0, self.free),)

    def link_length(self, length: jax.Array) -> jax.Array:
        return length[: self.free]
