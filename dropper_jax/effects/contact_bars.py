"""Contacts of round bars in `line_contact`: pairs of links, and links with the bars of bodies and buoys."""

from __future__ import annotations

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import dot
from dropper_jax.model import Graph, ModelView

#: A group of lines by their numbers.
Group = tuple[int, ...]


@component
class ContactPairs:
    """Lines that may touch each other, and bars of bodies and buoys with the lines that may touch them.

    The owner of a bar is the number of a body, or -1 minus the number of a buoy's point.
    """

    axis: Array = parameter("axes of bars relative to their owners (bars, 2, 3)", unit="m", shape="vectors")
    radius: Array = parameter("their radii", unit="m", shape="table")
    weights: Array = parameter("weights of four nodes in the ends of axes (bars, 2, 4)", unit="-", shape="vectors")
    corner: int = option("number of the first body's first corner among the points", type=int, default=0)
    line_pairs: tuple[tuple[Group, Group], ...] = option("pairs of lines", type=tuple, default=())
    line_bars: tuple[tuple[Group, int], ...] = option("lines and the owner of each bar", type=tuple, default=())

    @property
    def owners(self) -> np.ndarray:
        """Owner of each bar (bars,)."""
        return np.array([owner for _, owner in self.line_bars], int)

    @property
    def rigid(self) -> bool:
        """Whether a bar belongs to a rigid body."""
        return bool(np.any(self.owners >= 0))

    def nodes(self, graph: Graph) -> np.ndarray:
        """Nodes of the pieces, first pairs of links, then links with bars: four each; with rigid bodies six, those of a
        link and the body's corners."""
        first, second = _links_and_links(graph, self.line_pairs)
        link, bar = _links_and_bars(graph, self.line_bars)
        owners = self.owners[bar]
        pairs = [graph.first[first], graph.last[first], graph.first[second], graph.last[second]]
        own = graph.point_node[np.where(owners < 0, -1 - owners, 0)]
        bars = [graph.first[link], graph.last[link], own, own]
        if self.rigid:
            pairs += [graph.first[first]] * 2
            corners = self.corner + 4 * np.maximum(owners, 0) + np.arange(4)[:, None]
            bars[2:] = np.where(owners >= 0, graph.point_node[corners], own)
        return np.concatenate([np.stack(pairs, axis=1), np.stack(bars, axis=1)])


#: Rounding of the nearest point for parallel axes, relative to the square of their lengths: they meet at their middles,
#: and the contact point moves smoothly (over 0.3 degrees) as they turn away from parallel.
PARALLEL_ROUNDING = 0.5e-5


class Bars:
    """The axes of all pieces, from the positions of their nodes.

    Attributes:
        reach: sums of radii (pieces,) [m].
        spread: see `nearest_points`, (pieces,) [m^2].
    """

    def __init__(self, pairs: ContactPairs, radius: Array, model: ModelView) -> None:
        """The bars of a model, whose links have these radii (n,) [m]."""
        length = model.line.length
        radius = jnp.broadcast_to(radius, length.shape)
        first, second = _links_and_links(model.geometry, pairs.line_pairs)
        link, bar = _links_and_bars(model.geometry, pairs.line_bars)
        axis = pairs.axis[bar]
        across = axis[:, 1] - axis[:, 0]
        self.reach = jnp.concatenate([radius[first] + radius[second], radius[link] + pairs.radius[bar]])
        square = jnp.concatenate([length[first] ** 2 + length[second] ** 2, length[link] ** 2 + dot(across, across)])
        self.spread = PARALLEL_ROUNDING * jax.lax.stop_gradient(square)
        self.pairs = len(first)  # pairs of links come first
        self.weights = pairs.weights[bar] if pairs.rigid else None
        self.offset = jnp.where((pairs.owners[bar] < 0)[:, None, None], axis, 0.0)

    def axes(self, r: Array) -> Array:
        """Ends of both axes (pieces, 4, 3) [m] of pieces whose nodes are at r (pieces, m, 3)."""
        p = self.mix_velocities(r)
        if not len(self.offset):
            return p
        more = jnp.concatenate([jnp.zeros_like(self.offset), self.offset], axis=1)
        return p + jnp.concatenate([jnp.zeros((self.pairs, 4, 3), p.dtype), more])

    def mix_velocities(self, v: Array) -> Array:
        """Velocities of the ends of both axes (pieces, 4, 3) from those of the nodes (pieces, m, 3)."""
        if self.weights is None:
            return v
        other = jnp.sum(self.weights[..., None] * v[self.pairs :, None, 2:], axis=-2)
        return jnp.concatenate([v[:, :2], jnp.concatenate([v[: self.pairs, 2:4], other])], axis=1)

    def spread_out(self, force: Array) -> Array:
        """Forces on the ends of the axes (pieces, 4, 3), distributed to the nodes of their pieces (pieces, m, 3)."""
        if self.weights is None:
            return force
        own = jnp.sum(self.weights[..., None] * force[self.pairs :, 2:, None], axis=1)
        links = jnp.pad(force[: self.pairs, 2:], ((0, 0), (0, 2), (0, 0)))
        return jnp.concatenate([force[:, :2], jnp.concatenate([links, own])], axis=1)


@lru_cache(maxsize=64)
def _links_and_links(graph: Graph, line_pairs: tuple[tuple[Group, Group], ...]) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of links that may touch: all links of one group with all of the other, except those that share a point."""
    found = [np.zeros((2, 0), int)]
    for first, second in line_pairs:
        shared = _points_of(graph, first) & _points_of(graph, second)
        links = _links_except(graph, first, shared)
        others = _links_except(graph, second, shared)
        found.append(np.stack([np.repeat(links, len(others)), np.tile(others, len(links))]))
    return tuple(np.concatenate(found, axis=1))


def _points_of(graph: Graph, group: Group) -> set[int]:
    """Points at the ends of a group of lines."""
    members = [graph.members[i] for i in group]
    return {member.start for member in members} | {member.end for member in members}


def _links_except(graph: Graph, group: Group, away: set[int]) -> np.ndarray:
    """Links of a group of lines, except those that end at given points."""
    found = []
    for i in group:
        member = graph.members[i]
        first = graph.spans[i].start + (member.start in away)
        stop = graph.spans[i].stop - (member.end in away)
        found.append(np.arange(first, stop))
    return np.concatenate(found)


@lru_cache(maxsize=64)
def _links_and_bars(graph: Graph, line_bars: tuple[tuple[Group, int], ...]) -> tuple[np.ndarray, np.ndarray]:
    """Links and the bars that they may touch, without those that end at a buoy's point."""
    found = [np.zeros((2, 0), int)]
    for bar, (group, owner) in enumerate(line_bars):
        links = _links_except(graph, group, {-1 - owner} if owner < 0 else set())
        found.append(np.stack([links, np.full_like(links, bar)]))
    return tuple(np.concatenate(found, axis=1))
