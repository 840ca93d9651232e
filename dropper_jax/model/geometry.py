"""Connectivity of nodes, links and points: the interface shared by a path and a graph of links.

Distribution of water forces: which part of a link acts on which node, and its submerged fraction.

A link's water forces are distributed to its nodes as its mass is: all to its far node for point-mass links, according
to the centre of mass for compound ones. A node's part is submerged if the surface is above it, smoothly over the height
of the link there: `w = s^2 (3 - 2 s)`, `s = 1/2 + (eta - z)/(D + L |q_z|)` between 0 and 1, q the link's direction.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.renamed import old_attribute


class Part(ABC):
    """One share of the links' water forces: the rows on which it is computed, and the mapping from and to the free
    nodes.

    Attributes:
        share: the fraction of a link's force, a number or (rows,).
    """

    share: jax.Array | float

    @abstractmethod
    def take(self, per_link: jax.Array) -> jax.Array:
        """Values (n, ...) of the links, one per row; a number stays one."""

    @abstractmethod
    def at(self, nodal: jax.Array) -> jax.Array:
        """Values (nodes, ...) of the free nodes, one per row."""

    @abstractmethod
    def collect(self, rows: jax.Array) -> jax.Array:
        """Sum of the rows on the free nodes (nodes, ...)."""


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
        return jnp.pad(kept, ((self.first, links - self.first - kept.shape[0]), (0, 0)))


class Ends(NamedTuple):
    """Fixed points, in the order of `Geometry.held_points`: positions (held, 3) [m], velocities [m/s] (None: at
    rest)."""

    positions: jax.Array
    velocities: jax.Array | None = None

    __getattr__ = old_attribute

    @property
    def start(self) -> jax.Array:
        """Start point of a single line (3,) [m]."""
        return self.positions[0]

    @property
    def end(self) -> jax.Array | None:
        """End point of a single line (3,) [m]; None if that end is free."""
        return self.positions[1] if self.positions.shape[0] > 1 else None


class Member(NamedTuple):
    """One line: its name, its number of links and the numbers of its start and end points.

    Attributes:
        far: whether a link's mass and forces go to its far node, not in halves to both; in a path they all do.
    """

    name: str
    links: int
    start: int
    end: int
    far: bool = False


def line_number(line: str | int, names: Sequence[str]) -> int:
    """The number of a line, by name or number."""
    if line in names:
        return names.index(line)
    if isinstance(line, int) and 0 <= line < len(names):
        return line
    raise ValueError(f"line: {line!r} is unknown; allowed: {', '.join(names)} or 0 to {len(names) - 1}")


class Geometry(ABC):
    """Static, so that equal ones share compiled programs. Nodal fields are of the free nodes, `held` of fixed points.

    `members` are the lines; `held` tells which points are fixed or follow a prescribed motion: of a graph all points,
    of a path its two ends.
    """

    members: tuple[Member, ...]
    held: tuple[bool, ...]
    #: Whether it is a system of lines joined at points.
    branched: ClassVar[bool] = False

    @property
    def links(self) -> int:
        return sum(m.links for m in self.members)

    @property
    def ends(self) -> int:
        """Number of fixed points."""
        return sum(self.held)

    @cached_property
    def held_points(self) -> np.ndarray:
        """Numbers of the fixed points, in the order of `Ends`."""
        return np.flatnonzero(np.array(self.held))

    @cached_property
    def spans(self) -> tuple[slice, ...]:
        """The links of each line."""
        ends = np.cumsum([0, *(m.links for m in self.members)])
        return tuple(slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True))

    def line_names(self) -> list[str]:
        """Names of lines as specified, and of the pieces of those that are cut at points."""
        names = [member.name for member in self.members]
        stems = [name.rpartition("-")[0] for name in names if name.rpartition("-")[2].isdecimal()]
        return list(dict.fromkeys(name for name in (*names, *stems) if name))

    def line_links(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Numbers of the links of each line as specified; pieces `name-1`, `name-2` of a cut one belong to it."""
        found: dict[str, list[np.ndarray]] = {name: [] for name in names}
        for member, span in zip(self.members, self.spans, strict=True):
            stem, _, piece = member.name.rpartition("-")
            own = member.name if member.name in found else stem if piece.isdecimal() else member.name
            if own in found:
                found[own].append(np.arange(self.links)[span])
        return {name: np.concatenate(parts) for name, parts in found.items()}

    @cached_property
    def previous_links(self) -> np.ndarray:
        """The link before each node inside a line; the one after it is the next."""
        return np.concatenate([np.arange(s.start, s.stop - 1) for s in self.spans]).astype(int)

    @property
    @abstractmethod
    def free(self) -> int:
        """Number of free nodes."""

    @property
    @abstractmethod
    def paths(self) -> tuple[np.ndarray, ...]:
        """Numbers of each line's nodes (links + 1,), both ends included; numbers of fixed ones are above those of free
        nodes."""

    @abstractmethod
    def nodes(self, free: jax.Array, held: jax.Array) -> jax.Array:
        """A nodal field on the nodes of all lines, line after line, both ends of each included (n + lines, ...)."""

    @abstractmethod
    def differences(self, free: jax.Array, held: jax.Array | None) -> jax.Array:
        """Differences of a nodal field over the links (n, ...); fixed points without values count as zero."""

    @abstractmethod
    def gather(self, link_force: jax.Array) -> jax.Array:
        """Sum on the free nodes (free, ...) of the links' tension forces (n, ...): + on their first node, - on their
        last."""

    @abstractmethod
    def held_force(self, link_force: jax.Array) -> jax.Array:
        """The same on the fixed points (held, ...)."""

    @abstractmethod
    def share_to_nodes(self, value: jax.Array) -> jax.Array:
        """Values that links have or carry (n,), on the free nodes (free,) that they are assigned to."""

    @abstractmethod
    def parts(self) -> tuple[Part, ...]:
        """The same for water forces, as shares (see `effects.buoyancy.wet_share`)."""

    @abstractmethod
    def link_length(self, length: jax.Array) -> jax.Array:
        """Length of the links at each free node (free,) [m]."""

    @abstractmethod
    def without_fixed(self, points: Sequence[int]) -> Geometry:
        """The same with these points free."""

    @abstractmethod
    def node_of_point(self, point: int) -> int:
        """Number of a free point among the free nodes."""

    def name_of_node(self, node: int, points: Sequence[str]) -> str:
        """A free node by its point or by its line and number, with the names of all points."""
        return f"node {node + 1}"

    def values_or_zero(self, value: jax.Array | None, like: jax.Array) -> jax.Array:
        """Values of the fixed points, zero if None, in the form of the nodal field `like`."""
        return jnp.zeros((self.ends, *like.shape[1:]), like.dtype) if value is None else value

    def node(self, line: str | int, j: int) -> int:
        """Number among the free nodes of node j of a line, from 0, its first point.

        Raises:
            ValueError: no such line or node, or the node is fixed.
        """
        numbers = self.paths[line_number(line, [m.name for m in self.members])]
        if not 0 <= j < len(numbers):
            raise ValueError(f"node: {j} is not a node of line {line!r}; allowed: 0 to {len(numbers) - 1}")
        if not 0 <= numbers[j] < self.free:
            raise ValueError(f"node: {j} of line {line!r} is fixed; allowed: a free node")
        return int(numbers[j])
