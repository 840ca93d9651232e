"""Contacts of round bars in `line_contact`: pairs of links, and links with the bars of bodies and buoys."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.numerics import dot
from dropper_jax.model import Graph, ModelView

# --- the nearest points of two straight axes, and the force that pushes them apart ---
#
# Bars are pieces p of four positions (..., 4, 3): the ends of the first axis and of the second.


class Nearest(NamedTuple):
    """Nearest points of two axes.

    Attributes:
        distance: (...,) [m].
        separation: gradient of the distance with respect to the point on the first axis (..., 3): a unit vector away
            from the second.
        shares: weights of the ends of the axes in the difference of the two nearest points (..., 4).
    """

    distance: jax.Array
    separation: jax.Array
    shares: jax.Array


def nearest_points(p: jax.Array, reach: jax.Array, spread: jax.Array) -> Nearest:
    """The minimum of `|p0 + s u - q0 - t w|^2 + spread ((s - 1/2)^2 + (t - 1/2)^2)` over s and t from 0 to 1.

    The function is strictly convex in s and t, so the points move continuously, and the root of the minimum has the
    gradient of the distance at fixed s and t. It is found in three steps: s without the limits on t, t at that s, s at
    that t, each clipped to 0 to 1 (Ericson 2005, 5.1.9, which is exact for any such function).

    Args:
        p: ends of the axes (..., 4, 3) [m]; reach: sum of the radii (...,) [m]; spread: (...,) [m^2].
    """
    u, w, off = p[..., 1, :] - p[..., 0, :], p[..., 3, :] - p[..., 2, :], p[..., 0, :] - p[..., 2, :]
    a, b, c = dot(u, u) + spread, dot(u, w), dot(w, w) + spread
    e, f = 0.5 * spread - dot(u, off), 0.5 * spread + dot(w, off)
    s = jnp.clip((e * c + b * f) / (a * c - b * b), 0.0, 1.0)
    t = jnp.clip((b * s + f) / c, 0.0, 1.0)
    s = jnp.clip((b * t + e) / a, 0.0, 1.0)
    apart = off + s[..., None] * u - t[..., None] * w
    least = dot(apart, apart) + spread * ((s - 0.5) ** 2 + (t - 0.5) ** 2)
    # distance relative to the reach below which axes count as this far apart, so that the force direction stays defined
    distance = jnp.sqrt(least + (1e-2 * reach) ** 2)
    return Nearest(distance, apart / distance[..., None], jnp.stack([1.0 - s, s, t - 1.0, -t], axis=-1))


def contact_force(distance: jax.Array, reach: jax.Array, stiffness: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Energy [J] and force [N] of compressed bars: `V = k/2 p^2 R/d`, `N = k p (R/d) (1 + p/(2 d))`, p = R - d.

    A spring k at first touch; with d of at least R/100 the axes meet at 49 k R^2.
    """
    deep, ratio = jnp.maximum(reach - distance, 0.0), reach / distance
    return 0.5 * stiffness * deep**2 * ratio, stiffness * deep * ratio * (1.0 + 0.5 * deep / distance)


def relative_motion(before: jax.Array, after: jax.Array) -> jax.Array:
    """Maximum motion (...,) [m] of any point of one axis relative to any point of the other."""
    moved = after - before
    each = moved[..., :2, None, :] - moved[..., None, 2:, :]
    return jnp.sqrt(jnp.max(dot(each, each), axis=(-2, -1)))


#: A group of lines by their numbers.
Group = tuple[int, ...]


class Touching(Protocol):
    """Description of the bars of an effect, see `line_contact.LinksInContact`."""

    radius: jax.Array
    bars: jax.Array
    bar_radius: jax.Array
    mixed: jax.Array
    beside: tuple[tuple[Group, Group], ...]
    along: tuple[tuple[Group, int], ...]

    @property
    def rigid(self) -> bool:
        """Whether a bar belongs to a rigid body."""


class Bars:
    """The axes of all pieces, from the positions of their nodes.

    Attributes:
        reach: sums of radii (pieces,) [m].
        spread: see `segments.nearest_points`, (pieces,) [m^2].
    """

    def __init__(self, effect: Touching, model: ModelView) -> None:
        length, radius = model.line.length, jnp.broadcast_to(effect.radius, model.line.length.shape)
        first, second = _links(model.geometry, effect.beside)
        link, bar = _links_and_bars(model.geometry, effect.along)
        axis = effect.bars[bar] if len(bar) else jnp.zeros((0, 2, 3), length.dtype)
        across = axis[:, 1] - axis[:, 0]
        other = effect.bar_radius[bar] if len(bar) else jnp.zeros(0, length.dtype)
        self.reach = jnp.concatenate([radius[first] + radius[second], radius[link] + other])
        square = jnp.concatenate([length[first] ** 2 + length[second] ** 2, length[link] ** 2 + dot(across, across)])
        # rounding of the nearest point for parallel axes, relative to the square of their lengths: they meet at their
        # middles, and the contact point moves smoothly (over 0.3 degrees) as they turn away from parallel
        self.spread = 0.5e-5 * jax.lax.stop_gradient(square)
        self.pairs, self.offset, self.shares = len(first), None, None
        if not len(bar):
            return
        owner = np.array([number for _, number in effect.along])[bar]
        self.shares = effect.mixed[bar] if effect.rigid else None
        self.offset = jnp.where((owner < 0)[:, None, None], axis, 0.0)

    def axes(self, r: jax.Array) -> jax.Array:
        """Ends of both axes (pieces, 4, 3) [m] of pieces whose nodes are at r (pieces, m, 3)."""
        p = self.mix_velocities(r)
        if self.offset is None:
            return p
        more = jnp.concatenate([jnp.zeros_like(self.offset), self.offset], axis=1)
        return p + jnp.concatenate([jnp.zeros((self.pairs, 4, 3), p.dtype), more])

    def mix_velocities(self, v: jax.Array) -> jax.Array:
        """The same for velocities."""
        if self.shares is None:
            return v
        other = jnp.sum(self.shares[..., None] * v[self.pairs :, None, 2:], axis=-2)
        return jnp.concatenate([v[:, :2], jnp.concatenate([v[: self.pairs, 2:4], other])], axis=1)

    def spread_out(self, force: jax.Array) -> jax.Array:
        """Forces on the ends of the axes (pieces, 4, 3), distributed to the nodes of their pieces (pieces, m, 3)."""
        if self.shares is None:
            return force
        own = jnp.sum(self.shares[..., None] * force[self.pairs :, 2:, None], axis=1)
        links = jnp.pad(force[: self.pairs, 2:], ((0, 0), (0, 2), (0, 0)))
        return jnp.concatenate([force[:, :2], jnp.concatenate([links, own])], axis=1)


@lru_cache(maxsize=64)
def _links(graph: Graph, beside: tuple[tuple[Group, Group], ...]) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of links that may touch: all links of one group with all of the other, except those that share a point."""
    found = [np.zeros((2, 0), int)]
    for groups in beside:
        own = [[graph.members[i] for i in group] for group in groups]
        points = [{end for member in members for end in (member.start, member.end)} for members in own]
        shared = points[0] & points[1]
        kept = [_links_except(graph, group, shared) for group in groups]
        found.append(np.stack([part.ravel() for part in np.meshgrid(*kept, indexing="ij")]))
    return tuple(np.concatenate(found, axis=1))


def _links_except(graph: Graph, group: Group, away: set[int]) -> np.ndarray:
    """Links of a group of lines, except those that end at given points."""
    lines = [(graph.members[i], graph.spans[i]) for i in group]
    return np.concatenate([np.arange(s.start + (m.start in away), s.stop - (m.end in away)) for m, s in lines])


@lru_cache(maxsize=64)
def _links_and_bars(graph: Graph, along: tuple[tuple[Group, int], ...]) -> tuple[np.ndarray, np.ndarray]:
    """Links and the bars that they may touch, without those that end at a buoy's point."""
    found = [np.zeros((2, 0), int)]
    for bar, (group, owner) in enumerate(along):
        links = _links_except(graph, group, {-1 - owner} if owner < 0 else set())
        found.append(np.stack([links, np.full_like(links, bar)]))
    return tuple(np.concatenate(found, axis=1))


@lru_cache(maxsize=64)
def nodes_of_bars(
    graph: Graph,
    beside: tuple[tuple[Group, Group], ...],
    along: tuple[tuple[Group, int], ...],
    corner: int,
) -> np.ndarray:
    """Nodes of the pieces: first pairs of links, then links with bars (pieces, 4 or 6)."""
    first, second = _links(graph, beside)
    link, bar = _links_and_bars(graph, along)
    rigid = any(owner >= 0 for _, owner in along)
    owners = np.array([number for _, number in along], int)[bar]
    points = graph.point_node[np.where(owners < 0, -1 - owners, 0)]
    own = np.repeat(points[:, None], 4 if rigid else 2, axis=1)
    if rigid:
        numbers = corner + 4 * np.maximum(owners, 0)[:, None] + np.arange(4)
        own = np.where((owners >= 0)[:, None], graph.point_node[numbers], own)
    pairs = [graph.first[first], graph.last[first], graph.first[second], graph.last[second]]
    pairs += [graph.first[first]] * 2 if rigid else []
    return np.concatenate(
        [
            np.stack(pairs, axis=1),
            np.concatenate([np.stack([graph.first[link], graph.last[link]], axis=1), own], axis=1),
        ]
    )
