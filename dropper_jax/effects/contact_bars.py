"""Contacts of round bars in `line_contact`: pairs of links, and links with the bars of bodies and buoys.

A piece is a pair of axes that may touch. Pieces of two links come first, those of a link and a bar after them. Four
nodes define the axes of a piece, or six if a rigid body owns any bar; every piece then has six.

| piece | 4 nodes | 6 nodes |
| --- | --- | --- |
| two links | first, last of one; first, last of the other | the same; first of the first link twice, not used |
| link, bar of a buoy | first, last; the buoy's point twice | first, last; the buoy's point four times |
| link, bar of a body | - | first, last; the four corners of the body |

The owner of a bar is the number of a body, or -1 minus the number of a buoy's point. The ends of a body's axis are
weighted means of its corners. Those of a buoy's axis have constant offsets from its point; its weights are 1, 0, 0, 0.
"""

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

    Owners are numbered as in the description of this module.
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
        """Nodes of the pieces (pieces, 4), with rigid bodies (pieces, 6), in the order of the module's table."""
        first, second = _links_and_links(graph, self.line_pairs)
        links, bars = _links_and_bars(graph, self.line_bars)
        owners = self.owners[bars]
        pair_nodes = [graph.first[first], graph.last[first], graph.first[second], graph.last[second]]
        own = graph.point_node[np.where(owners < 0, -1 - owners, 0)]
        bar_nodes = [graph.first[links], graph.last[links], own, own]
        if self.rigid:
            pair_nodes += [graph.first[first]] * 2
            corners = self.corner + 4 * np.maximum(owners, 0) + np.arange(4)[:, None]
            bar_nodes[2:] = np.where(owners >= 0, graph.point_node[corners], own)
        return np.concatenate([np.stack(pair_nodes, axis=1), np.stack(bar_nodes, axis=1)])


#: Rounding of the nearest point for parallel axes, relative to the square of their lengths: they meet at their middles,
#: and the contact point moves smoothly (over 0.3 degrees) as they turn away from parallel.
PARALLEL_ROUNDING = 0.5e-5


class Bars:
    """The axes of all pieces, from the positions of their nodes.

    Attributes:
        reach: sums of radii (pieces,) [m].
        parallel_rounding: see `nearest_points`, (pieces,) [m^2].
        pair_count: number of pieces of two links, which come first.
        intact: 0 for pieces of which a link has broken, else 1 (pieces,); 1.0 if no link can break.
    """

    def __init__(self, pairs: ContactPairs, radius: Array, model: ModelView) -> None:
        """The bars of a model, whose links have these radii (n,) [m]."""
        length = model.line.length
        radius = jnp.broadcast_to(radius, length.shape)
        first, second = _links_and_links(model.geometry, pairs.line_pairs)
        links, bars = _links_and_bars(model.geometry, pairs.line_bars)
        axis = pairs.axis[bars]
        across = axis[:, 1] - axis[:, 0]
        self.reach = jnp.concatenate([radius[first] + radius[second], radius[links] + pairs.radius[bars]])
        square = jnp.concatenate([length[first] ** 2 + length[second] ** 2, length[links] ** 2 + dot(across, across)])
        self.parallel_rounding = PARALLEL_ROUNDING * jax.lax.stop_gradient(square)
        self.pair_count = len(first)
        self.intact: Array | float = 1.0
        whole = model.line.axial.intact
        if whole is not None:
            self.intact = jnp.concatenate([whole[first] * whole[second], whole[links]])
        self.weights = pairs.weights[bars] if pairs.rigid else None
        self.offset = jnp.where((pairs.owners[bars] < 0)[:, None, None], axis, 0.0)

    def axes(self, r: Array) -> Array:
        """Ends of both axes (pieces, 4, 3) [m] of pieces whose nodes are at r (pieces, m, 3)."""
        p = self.at_axis_ends(r)
        if not len(self.offset):
            return p
        more = jnp.concatenate([jnp.zeros_like(self.offset), self.offset], axis=1)
        return p + jnp.concatenate([jnp.zeros((self.pair_count, 4, 3), p.dtype), more])

    def at_axis_ends(self, x: Array) -> Array:
        """Positions or velocities at axes' ends (pieces, 4, 3), without buoys' offsets, from nodes (pieces, m, 3)."""
        if self.weights is None:
            return x
        other = jnp.sum(self.weights[..., None] * x[self.pair_count :, None, 2:], axis=-2)
        return jnp.concatenate([x[:, :2], jnp.concatenate([x[: self.pair_count, 2:4], other])], axis=1)

    def to_nodes(self, force: Array) -> Array:
        """Forces on the ends of the axes (pieces, 4, 3), distributed to the nodes of their pieces (pieces, m, 3)."""
        if self.weights is None:
            return force
        own = jnp.sum(self.weights[..., None] * force[self.pair_count :, 2:, None], axis=1)
        links = jnp.pad(force[: self.pair_count, 2:], ((0, 0), (0, 2), (0, 0)))
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
