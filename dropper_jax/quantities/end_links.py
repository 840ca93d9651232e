"""Force of a line on a point: the tension of its end link, and the weight of the part of this link at the point.

    F = T q - W z,    W = share (m g - rho g V w)

T is the tension of the link, which is that at its middle, q its direction from the point outwards, `share` the fraction
of the link's mass at the point, w the submerged fraction of the part of the link next to the point. A point on the
seabed carries the part of W that the line lifts, and the seabed carries the rest. Drag and inertia of the part of the
link are neglected.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from dropper_jax.base.interpolation import interpolate_rows
from dropper_jax.base.numerics import safe_norm, unit_vectors
from dropper_jax.base.records import by_name
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.effects.submerged import submerged_fraction
from dropper_jax.load.scene import Scene
from dropper_jax.load.surface import Surface, bed_height
from dropper_jax.model import Model
from dropper_jax.modelling.growth import overgrown
from dropper_jax.scene import LineSlice, SceneData, WholeLine, sliced_lines

#: A NumPy or JAX array.
AnyArray = Any
#: Height over the seabed below which a point lies on it [m]: anchors are at its height.
ON_BED = 1e-3


class LinkPart(NamedTuple):
    """Links, or their parts at points (...): weight [N], buoyancy under water [N], length and diameter [m]."""

    weight: AnyArray
    lift: AnyArray
    length: AnyArray
    diameter: AnyArray

    def force(
        self, at: AnyArray, direction: AnyArray, tension: AnyArray, surface: AnyArray | None, bed: AnyArray
    ) -> AnyArray:
        """Force (..., 3) [N] of links on their points; the buoyancy is smooth as in `effects.buoyancy`.

        Args:
            at: the points (..., 3) [m].
            direction: unit vectors (..., 3) along the links, from the points outwards.
            tension: of the links (...) [N].
            surface, bed: heights of the surface and the seabed at the points (...) [m]; None without buoyancy.
        """
        xp = at.__array_namespace__()  # NumPy or jax.numpy
        weight = self.weight
        if surface is not None:
            rise = self.length * direction[..., 2]
            submerged = submerged_fraction(surface - at[..., 2] - 0.5 * rise, self.diameter + abs(rise))
            weight = weight - self.lift * submerged
        force = tension[..., None] * direction
        lifted_by_line = xp.minimum(weight, xp.maximum(force[..., 2], 0.0))
        carried_by_point = xp.where(at[..., 2] < bed + ON_BED, lifted_by_line, weight)
        return force - carried_by_point[..., None] * np.array([0, 0, 1])


class End(NamedTuple):
    """An end of a line: the nodes there and next to it in the lines' arrays, the link between them, and whether it is
    the line's last one."""

    nodes: list[int]
    link: int
    last: bool


def ends_of(line: LineSlice | WholeLine) -> tuple[End, End]:
    """Both ends of a line."""
    nodes = np.r_[line.nodes].tolist()
    return End(nodes[:2], line.links.start, False), End(nodes[-1:-3:-1], line.links.stop - 1, True)


def line_ends(scene: SceneData) -> Iterator[tuple[str, End]]:
    """Both ends of every line of a scene, each with its point."""
    for line, where in sliced_lines(scene):
        yield from zip((line.start, line.end), ends_of(where), strict=True)


def loaded_fixed_points(scene: SceneData) -> list[str]:
    """Names of the fixed points at which a line ends."""
    ends = {name for name, _ in line_ends(scene)}
    return [name for name in scene.fixed_points if name in ends]


class Motion(NamedTuple):
    """Nodes (k, nodes, 3) [m] of all lines at the saved times t (k,) [s], tensions (q, n) [N] at `t_tension` (q,)."""

    scene: Scene
    t: np.ndarray
    positions: np.ndarray
    t_tension: np.ndarray
    tension: np.ndarray

    def end_force(self, links: EndLinks, end: End) -> np.ndarray:
        """Force (q, 3) [N] of an end link on its point, from its two nodes alone: all may be larger than memory."""
        nodes = interpolate_rows(self.t, self.positions[:, end.nodes], self.t_tension)
        return links.force(end, nodes, self.tension, self.t_tension)


def point_loads(motion: Motion, waves: bool = True) -> dict[str, np.ndarray]:
    """Force (q, 3) [N] of all lines on each fixed point, at the times of the tensions; `waves` as of `EndLinks`."""
    links = EndLinks(motion.scene, waves)
    loads = {name: np.zeros((len(motion.t_tension), 3)) for name in motion.scene.fixed_points}
    for point, end in line_ends(motion.scene):
        if point in loads:
            loads[point] += motion.end_force(links, end)
    return loads


def load_vectors(motion: Motion) -> np.ndarray:
    """The same of the points at which a line ends, as `loaded_fixed_points` lists them (q, points, 3) [N]."""
    loads = point_loads(motion)
    names = loaded_fixed_points(motion.scene)
    return np.reshape([loads[name] for name in names], (len(names), len(motion.t_tension), 3)).swapaxes(0, 1)


@dataclass(frozen=True)
class EndLinks:
    """The links of a scene's lines with their mussels, and the forces of those at the ends.

    Attributes:
        waves: whether the surface is that of the waves; otherwise the mean one.
    """

    given: Scene
    waves: bool = True

    @cached_property
    def scene(self) -> Scene:
        """With mussels in masses and diameters."""
        return overgrown(self.given)

    @cached_property
    def links(self) -> LinkPart:
        """All links (n,): their weight is that in water if this is given; without buoyancy the diameter is zero."""
        scene = self.scene
        line = scene.line
        weight = np.zeros(line.links)
        if "weight" in scene.effects:
            wet_weight = scene.effects["weight"]["wet_weight"]
            weight = weight + (line.mass * scene.gravity if wet_weight is None else wet_weight)
        diameter = displaced_diameter(line, scene)
        if diameter is None or "buoyancy" not in scene.effects:
            diameter = np.zeros(line.links)
        lift = np.zeros(line.links)
        if scene.sea is not None:
            lift = scene.sea.density * scene.sea.gravity * 0.25 * np.pi * diameter**2 * line.length
        return LinkPart(weight, lift, line.length, diameter)

    @cached_property
    def first_share(self) -> np.ndarray:
        """Fraction of each link's weight (n,) at its first node; the rest is at its last."""
        kinds = self.scene.link_mass_nodes
        shares = []
        for line in self.scene.lines:
            share = np.zeros(line.links)  # all at the far node
            if kinds[line.name] == "centre_of_mass":
                share = 1.0 - line.centre_of_mass / line.length
            elif kinds[line.name] == "shared":
                share = np.full(line.links, 0.5)
            shares.append(share)
        return np.concatenate(shares)

    @cached_property
    def _surface(self) -> Surface:
        """The surface of the water in time."""
        return Surface(self.scene, self.waves)

    def force(self, end: End, nodes: np.ndarray, tension: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Force (k, 3) [N] of an end link on its point at times t (k,) [s].

        Args:
            nodes: those of the end (k, 2, 3) [m]; tension: of all links (k, n) [N].
        """
        share = self.first_share[end.link]
        if end.last:
            share = 1.0 - share
        weight, lift, length, diameter = (values[end.link] for values in self.links)
        part = LinkPart(share * weight, share * lift, share * length, diameter)
        at = nodes[:, 0]
        bed = bed_height(self.scene, at)
        if bed is None:
            bed = -np.inf
        surface = None
        if part.lift != 0.0:
            surface = np.inf
            if not np.all(at[:, 2] + part.length + diameter < self._surface.lowest):
                surface = self._surface.over(at[:, None], t)[:, 0]
        with np.errstate(invalid="ignore"):  # a failed run may end with infinite positions
            return part.force(at, unit_vectors(nodes[:, 1] - at), tension[:, end.link], surface, bed)


def load_on_fixed_point(
    model: Model, links: tuple[int, ...], signs: tuple[float, ...], r: AnyArray, tension: AnyArray, t: AnyArray
) -> AnyArray:
    """Force (3,) [N] of all lines on a fixed point, differentiable.

    Args:
        links: those that end there; signs: 1 for links that start there, -1 for links that end there.
        r: free nodes (nodes, 3) [m]; tension: of all links (n,) [N]; t: time [s].
    """
    nodes = model.geometry.everywhere(r, model.ends(t).positions)
    starts = np.array(signs) > 0.0
    return jnp.sum(end_forces_of_model(model, np.array(links), starts, nodes, tension, t), axis=0)


def end_forces_of_model(
    model: Model, links: np.ndarray, starts: np.ndarray, nodes: AnyArray, tension: AnyArray, t: AnyArray
) -> AnyArray:
    """Force (m, 3) [N] of end links on their points, differentiable.

    Args:
        links: the end links (m,); starts: whether each link starts at its point or ends there (m,).
        nodes: all nodes, free ones first (see `Graph.everywhere`) [m]; tension: of all links (n,) [N]; t: time [s].
    """
    line = model.line
    both = np.stack([model.geometry.first[links], model.geometry.last[links]])
    point, inner = np.where(starts, both, both[::-1])
    at = nodes[point]
    along = nodes[inner] - at
    near = jnp.broadcast_to(jnp.asarray(line.near_share, nodes.dtype), line.length.shape)[links]
    share = jnp.where(starts, near, 1.0 - near)
    effects: dict[str, Any] = by_name(model.effects)
    weight = jnp.zeros_like(share)
    if "weight" in effects:
        weight = share * effects["weight"].per_link(line)[links]
    surface = None
    lift = jnp.zeros_like(share)
    diameter = lift
    if "buoyancy" in effects and model.sea is not None and line.diameter is not None:
        surface = model.sea.elevation(at, t)
        lift = share * effects["buoyancy"].per_link(model)[links]
        diameter = jnp.broadcast_to(line.diameter, line.length.shape)[links]
    bed = -jnp.inf
    if "seabed" in effects:
        bed = effects["seabed"].bed_height(at, rounded=0.0)
    part = LinkPart(weight, lift, share * line.length[links], diameter)
    return part.force(at, along / safe_norm(along)[:, None], tension[links], surface, bed)
