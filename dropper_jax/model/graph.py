"""Lines joined at points: a static graph of nodes and links, in the form that array operations need.

Numbering of free nodes: the inner nodes of line 0, of line 1, ..., then the free points. Fixed points follow them in
the numbering of all nodes. Links are numbered line by line from each line's first point. Every sum over the links of a
node is a gather, never a scatter: inner nodes have two links, points a short list.

A single line is a graph with one member, a path: its neighbours are found by slices (`take`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.indexed_sums import gather_sums, index_table

#: Number of runs of consecutive indices up to which slices are joined in place of a gather.
RUNS = 3


def take(values: Array, index: np.ndarray) -> Array:
    """Rows of `values` by static indices; where these are few runs of consecutive numbers, as in a path, by slices."""
    if not len(index):
        return values[:0]
    runs = np.split(index, np.flatnonzero(np.diff(index) != 1) + 1)
    if len(runs) > RUNS:
        return values[index]
    return jnp.concatenate([values[run[0] : run[-1] + 1] for run in runs])


class LinkEnd:
    """One end of all links, on which a share of their water forces acts: rows are links.

    Attributes:
        share: the fraction of a link's force, a number or (n,); zero at fixed points.
    """

    def __init__(self, graph: Graph, last: bool, share: Array | np.ndarray | float) -> None:
        node = graph.first
        #: Sum of the rows on the free nodes (nodes, ...).
        self.collect = graph.from_first
        if last:
            node = graph.last
            self.collect = graph.from_last
        fixed = node >= graph.free
        self.share = share
        if fixed.any():
            self.share = jnp.where(fixed, 0.0, share)
        self._node = np.where(fixed, max(graph.free - 1, 0), node)

    def at(self, nodal: Array) -> Array:
        """Values (nodes, ...) of the free nodes, one per row; those of fixed points are arbitrary."""
        return take(nodal, self._node)


class Member(NamedTuple):
    """One line of a graph.

    Attributes:
        name: of the line.
        links: number of its links.
        start, end: numbers of the points at its ends.
        far: whether a link's mass and forces go to its far node, as in a path; otherwise half of them to each node.
        piece_of: name of the line of which it is a piece, if attached points cut that line.
    """

    name: str
    links: int
    start: int
    end: int
    far: bool = False
    piece_of: str | None = None

    @property
    def near_share(self) -> float:
        """Fraction of a link's mass and forces at its first node."""
        return 0.0 if self.far else 0.5


@dataclass(frozen=True)
class Graph:
    """Lines joined at points; each link's mass, weight and forces go in halves to its two ends (lumped, as in MoorDyn).

    Those of lines whose members have `far` go to the links' far nodes. Lines have no free ends here: a free end is a
    free point. Static, so that equal ones share compiled programs. Nodal fields are of the free nodes, `held` of fixed
    points.

    Attributes:
        members: the lines.
        held: of all points, whether they are fixed or follow a prescribed motion.
        is_path: whether it is a single line from a fixed point, not a system of lines joined at points.
    """

    members: tuple[Member, ...]
    held: tuple[bool, ...]
    is_path: bool = False

    @property
    def links(self) -> int:
        return sum(m.links for m in self.members)

    @property
    def ends(self) -> int:
        """Number of fixed points."""
        return sum(self.held)

    @cached_property
    def held_points(self) -> np.ndarray:
        """Numbers of the fixed points, in the order of `Ends`: along a path."""
        if self.is_path:
            return np.array([point for point in (self.members[0].start, self.members[0].end) if self.held[point]])
        return np.flatnonzero(np.array(self.held))

    @cached_property
    def spans(self) -> tuple[slice, ...]:
        """The links of each line."""
        ends = np.cumsum([0, *(m.links for m in self.members)])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))

    def line_names(self) -> list[str]:
        """Names of lines and pieces, and of the lines that are cut into pieces."""
        names = [member.name for member in self.members]
        names += [member.piece_of for member in self.members if member.piece_of is not None]
        return list(dict.fromkeys(names))

    def line_links(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Numbers of the links of lines, pieces, or lines that are cut into pieces."""
        found: dict[str, list[np.ndarray]] = {name: [] for name in names}
        for member, span in zip(self.members, self.spans, strict=True):
            for name in {member.name, member.piece_of or member.name}.intersection(found):
                found[name].append(np.arange(span.start, span.stop))
        return {name: np.concatenate(parts) for name, parts in found.items()}

    @cached_property
    def previous_links(self) -> np.ndarray:
        """The link before each node inside a line; the one after it is the next."""
        return np.concatenate([np.arange(s.start, s.stop - 1) for s in self.spans]).astype(int)

    @cached_property
    def inner(self) -> int:
        """Number of inner nodes of all lines."""
        return sum(m.links - 1 for m in self.members)

    @cached_property
    def free_points(self) -> np.ndarray:
        """Numbers of the free points, in the order of their nodes."""
        return np.flatnonzero(~np.array(self.held))

    @property
    def free(self) -> int:
        """Number of free nodes."""
        return self.inner + len(self.free_points)

    @cached_property
    def point_node(self) -> np.ndarray:
        """Number of each point among all nodes."""
        node = np.zeros(len(self.held), int)
        node[self.free_points] = self.inner + np.arange(len(self.free_points))
        node[self.held_points] = self.free + np.arange(len(self.held_points))
        return node

    @cached_property
    def paths(self) -> tuple[np.ndarray, ...]:
        """Numbers of each line's nodes (links + 1,) among all nodes, both ends included."""
        node = self.point_node
        inner = np.split(np.arange(self.inner), np.cumsum([m.links - 1 for m in self.members]))
        lines = zip(self.members, inner, strict=False)
        return tuple(np.array([node[m.start], *nodes, node[m.end]], int) for m, nodes in lines)

    @cached_property
    def near_share(self) -> Array | np.ndarray | float:
        """Fraction of each link's mass and forces (n,) at its first node; one number if it is the same for all."""
        shares = [m.near_share for m in self.members]
        if len(set(shares)) == 1:
            return shares[0]
        # exact in half precision: models keep their precision
        return np.repeat(shares, [m.links for m in self.members]).astype("f2")

    @cached_property
    def first(self) -> np.ndarray:
        """First node of each link (n,) among all nodes."""
        return np.concatenate([path[:-1] for path in self.paths])

    @cached_property
    def last(self) -> np.ndarray:
        """Last node of each link (n,) among all nodes."""
        return np.concatenate([path[1:] for path in self.paths])

    def _incident(self, node_of_link: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Links (most, points) that have the point on that side; `links` as padding."""
        return index_table([np.flatnonzero(node_of_link == self.point_node[point]) for point in points], self.links)

    @cached_property
    def leaving(self) -> np.ndarray:
        """Links that start at each free point, padded with the number of links."""
        return self._incident(self.first, self.free_points)

    @cached_property
    def arriving(self) -> np.ndarray:
        """Links that end at each free point, padded with the number of links."""
        return self._incident(self.last, self.free_points)

    def everywhere(self, free: Array, held: Array | None) -> Array:
        """A nodal field on all nodes; fixed points without values count as zero."""
        if held is None:
            held = jnp.zeros((self.ends, *free.shape[1:]), free.dtype)
        return jnp.concatenate([free, held])

    def nodes(self, free: Array, held: Array | None) -> Array:
        """A nodal field on the nodes of all lines, line after line, both ends of each included (n + lines, ...)."""
        return take(self.everywhere(free, held), np.concatenate(self.paths))

    def differences(self, free: Array, held: Array | None) -> Array:
        """Differences of a nodal field over the links (n, ...); fixed points without values count as zero."""
        field = self.everywhere(free, held)
        return take(field, self.last) - take(field, self.first)

    @partial(jax.jit, static_argnums=0, inline=True)
    def from_first(self, value: Array) -> Array:
        """Sum on the free nodes (free, ...) of the contributions (n, ...) of links to their first nodes."""
        return self._sum(value, self.previous_links + 1, self.leaving)

    @partial(jax.jit, static_argnums=0, inline=True)
    def from_last(self, value: Array) -> Array:
        """Sum on the free nodes (free, ...) of the contributions (n, ...) of links to their last nodes."""
        return self._sum(value, self.previous_links, self.arriving)

    def _sum(self, value: Array, inner: np.ndarray, at_points: np.ndarray) -> Array:
        if at_points.size == 1:  # the free end of a path
            return take(value, np.append(inner, at_points))
        if at_points.shape[1]:
            return jnp.concatenate([take(value, inner), gather_sums(value, at_points)])
        return take(value, inner)

    def at_ends(self, first: Array | np.ndarray, last: Array | np.ndarray) -> Array:
        """Sum on the free nodes (free, ...) of values (n, ...) of links at their first and at their last nodes."""
        return self.from_first(first) + self.from_last(last)

    def gather(self, link_force: Array) -> Array:
        """Sum on the free nodes (free, ...) of the links' tension forces (n, ...): + on their first node, - on their
        last."""
        return self.from_first(link_force) - self.from_last(link_force)

    def held_at_ends(self, first: Array, last: Array) -> Array:
        """As `at_ends`, on the fixed points (held, ...)."""
        leaving = self._incident(self.first, self.held_points)
        arriving = self._incident(self.last, self.held_points)
        return gather_sums(first, leaving) + gather_sums(last, arriving)

    def held_force(self, link_force: Array) -> Array:
        """As `gather`, on the fixed points (held, ...)."""
        return self.held_at_ends(link_force, -link_force)

    def link_length(self, length: Array) -> Array:
        """The mean over the links that meet at each node."""
        links = self.at_ends(length, length)
        count = self.at_ends(jnp.ones_like(length), jnp.ones_like(length))
        return links / jnp.maximum(count, 1.0)

    def without_fixed(self, points: Sequence[int]) -> Graph:
        """The same with these points free, except the first point of a path."""
        if self.is_path:
            points = [point for point in points if point != self.members[0].start]
        return replace(self, held=tuple(held and i not in points for i, held in enumerate(self.held)))

    def node_of_point(self, point: int) -> int:
        """Number of a free point among the free nodes."""
        return int(self.point_node[point])

    def name_of_node(self, node: int, points: Sequence[str]) -> str:
        """A free node by its point or by its line and number, with the names of all points."""
        if node >= self.inner:
            return f"point {points[int(self.free_points[node - self.inner])]!r}"
        for member, path in zip(self.members, self.paths, strict=True):
            if node in path[1:-1]:
                return f"node {int(np.flatnonzero(path == node)[0])} of line {member.name!r}"
        return f"node {node}"

    def node(self, line: str | int, j: int) -> int:
        """Number among the free nodes of node j of a line, from 0, its first point.

        Raises:
            ValueError: no such line or node, or the node is fixed.
        """
        numbers = self.paths[_line_number(line, [m.name for m in self.members])]
        if not 0 <= j < len(numbers):
            raise ValueError(f"node: {j} is not a node of line {line!r}; allowed: 0 to {len(numbers) - 1}")
        if not 0 <= numbers[j] < self.free:
            raise ValueError(f"node: {j} of line {line!r} is fixed; allowed: a free node")
        return int(numbers[j])


def _line_number(line: str | int, names: Sequence[str]) -> int:
    """The number of a line, by name or number."""
    if line in names:
        return names.index(line)
    if isinstance(line, int) and 0 <= line < len(names):
        return line
    raise ValueError(f"line: {line!r} is unknown; allowed: {', '.join(names)} or 0 to {len(names) - 1}")
