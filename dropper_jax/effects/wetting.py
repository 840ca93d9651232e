"""What the effects of water share: which part of a link acts on which node, and how much of it is wet.

A link's water forces go to its nodes as its mass does: all on its far node for point-mass links, shared by the centre
of mass for compound ones. A node's part is wet where the surface is above it, smoothly over the height that the link
takes up there: `w = s^2 (3 - 2 s)`, `s = 1/2 + (eta - z)/(D + L |q_z|)` between 0 and 1, q the link's direction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

if TYPE_CHECKING:
    from dropper_jax.kinematics import Kinematics
    from dropper_jax.model import Line


class Part:
    """One share of the links' water forces: rows to compute them on, and the way from and to the free nodes.

    Attributes:
        share: what part of a link's force it is, a number or (rows,).
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
    """Of one line: the rows are its free nodes, each takes from one link."""

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


def path_parts(line: Line, free: int) -> Iterator[PathPart]:
    """The far ends of the links of one line and, where links are compound, their near ends."""
    if not line.compound:
        yield PathPart(1.0, 0, free)
        return
    ratio = line.centre_of_mass / line.length
    yield PathPart(ratio[:free], 0, free)
    near = PathPart(1.0, 1, free)
    yield replace(near, share=near.take(1.0 - ratio))


def parts(k: Kinematics) -> Iterator[Part]:
    """The parts of the lines' water forces."""
    return k.line.parts(k.free)


def wetted(k: Kinematics, part: Part, tangents: jax.Array, elevation: jax.Array) -> jax.Array:
    """Wet part of each row (rows,), 0 to 1."""
    line = k.line
    height = part.take(line.diameter * jnp.ones_like(line.length) + line.length * jnp.abs(tangents[:, 2]))
    # a free end has no next link: its near part has no height, and its share is zero
    height = jnp.where(height > 0.0, height, 1.0)
    s = jnp.clip(0.5 + part.at(elevation - k.r[:, 2]) / height, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


def split(u: jax.Array, tangent: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Parts of u (nodes, 3) across and along the tangents."""
    along = jnp.sum(u * tangent, axis=-1, keepdims=True) * tangent
    return u - along, along
