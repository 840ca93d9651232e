"""Force of a line on a point: the tension of its end link, and the weight of the part of this link at the point.

    F = T q - W z,    W = share (m g - rho g V w)

T is the tension of the link, which is that at its middle, q its direction from the point outwards, `share` the fraction
of the link's mass at the point, w the submerged fraction of the part of the link next to the point. A point on the
seabed carries W as far as the line lifts it there, the bed the rest. Drag and inertia of the part are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.numerics import safe_norm
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.effects.submerged import submerged_fraction
from dropper_jax.load.checks_water import Surface, bed_height
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.scene import LineSlice, WholeLine, sliced_lines

#: A NumPy or JAX array.
Array = Any
#: Height over the seabed below which a point lies on it [m]: anchors are at its height.
ON_BED = 1e-3


def force_on_point(direction: Array, tension: Array, weight: Array, lies: Array | bool, xp: ModuleType) -> Array:
    """Force (..., 3) [N] of an end link on its point.

    Args:
        direction: unit vectors (..., 3) along the link, from the point outwards.
        tension: of the link (...) [N].
        weight: of the part at the point, less its buoyancy (...) [N].
        lies: whether the point lies on the seabed.
        xp: `numpy` or `jax.numpy`.
    """
    force = tension[..., None] * direction
    lifted = xp.minimum(weight, xp.maximum(force[..., 2], 0.0))
    carried = xp.where(lies, lifted, weight)
    return force - carried[..., None] * np.array([0, 0, 1])


def wet_fraction(surface: Array, at: Array, direction: Array, length: Array, diameter: Array) -> Array:
    """Submerged fraction (...) of the part of a link next to its point, smooth as in `effects.buoyancy`.

    Args:
        surface: height of the water surface (...) [m]; at: the point (..., 3) [m].
        direction: unit vectors (..., 3) along the link, from the point outwards.
        length, diameter: of the part (...) [m].
    """
    rise = length * direction[..., 2]
    return submerged_fraction(surface - at[..., 2] - 0.5 * rise, diameter + abs(rise))


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


def line_ends(scene: Scene) -> Iterator[tuple[str, End]]:
    """Both ends of every line of a scene, each with its point."""
    for line, where in sliced_lines(scene):
        yield from zip((line.start, line.end), ends_of(where), strict=True)


def positions_at(t: np.ndarray, positions: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Positions (q, ...) [m] at times (q,) [s], linear between the saved positions (k, ...) at t (k,) [s]."""
    if len(t) < 2:
        return positions[np.zeros(len(times), int)]
    row = np.interp(times, t, np.arange(len(t)))
    low = np.minimum(row.astype(int), len(t) - 2)
    share = (row - low).reshape(-1, *[1] * (positions.ndim - 1))
    return (1 - share) * positions[low] + share * positions[low + 1]


@dataclass(frozen=True)
class EndLinks:
    """The end links of a scene's lines, mussels included (see `run.growth.overgrown`).

    Attributes:
        scene: with mussels in masses and diameters.
        waves: whether the surface is that of the waves; otherwise the mean one.
    """

    scene: Scene
    waves: bool = True

    @cached_property
    def weight(self) -> np.ndarray:
        """Weight (n,) [N] of each link in air; its weight in water if that is given."""
        line = self.scene.line
        weight = self.scene.effects.get("weight")
        if weight is None:
            return np.zeros(line.links)
        if weight["wet_weight"] is not None:
            return np.broadcast_to(np.asarray(weight["wet_weight"], float), (line.links,))
        return line.mass * self.scene.gravity

    @cached_property
    def diameter(self) -> np.ndarray:
        """Diameter (n,) [m] of the volume of each link that has buoyancy; zero without buoyancy."""
        if "buoyancy" in self.scene.effects:
            diameter = displaced_diameter(self.scene.line, self.scene)
        else:
            diameter = None
        if diameter is None:
            return np.zeros_like(self.weight)
        return np.broadcast_to(diameter, self.weight.shape)

    @cached_property
    def lift(self) -> np.ndarray:
        """Buoyancy (n,) [N] of each link under water."""
        sea = self.scene.sea
        if sea is None:
            return np.zeros_like(self.weight)
        return sea.density * sea.gravity * 0.25 * np.pi * self.diameter**2 * self.scene.line.length

    @cached_property
    def first_share(self) -> np.ndarray:
        """Fraction of each link's weight (n,) at its first node; the rest is at its last."""
        kinds = self.scene.link_mass_nodes
        shares = []
        for line in self.scene.lines:
            if kinds[line.name] == "centre_of_mass":
                shares.append(1.0 - line.centre_of_mass / line.length)
            elif kinds[line.name] == "shared":
                shares.append(np.full(line.links, 0.5))
            else:
                shares.append(np.zeros(line.links))
        return np.concatenate(shares)

    @cached_property
    def _surface(self) -> Surface:
        return Surface(self.scene, self.waves)

    def force_between(
        self, end: End, t: np.ndarray, positions: np.ndarray, t_tension: np.ndarray, tension: np.ndarray
    ) -> np.ndarray:
        """Force (q, 3) [N] of an end link on its point at the times of the tensions, between saved times.

        Args:
            t, positions: saved times (k,) [s] and nodes (k, nodes, 3) [m] of all lines.
            t_tension, tension: (q,) [s] and (q, links) [N].
        """
        return self.force(end, positions_at(t, positions[:, end.nodes], t_tension), tension, t_tension)

    def force(self, end: End, nodes: np.ndarray, tension: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Force (k, 3) [N] of an end link on its point at times t (k,) [s].

        Args:
            nodes: those of the end (k, 2, 3) [m]; tension: of all links (k, n) [N].
        """
        link = end.link
        tension = tension[:, link]
        bed = bed_height(self.scene, nodes[:, 0])
        with np.errstate(invalid="ignore"):  # a failed run may end with infinite positions
            along = nodes[:, 1] - nodes[:, 0]
            direction = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
            share = 1.0 - self.first_share[link] if end.last else self.first_share[link]
            weight = np.full(len(tension), share * self.weight[link])
            if share * self.lift[link] != 0.0:
                wet = self._wet(nodes[:, 0], direction, share * self.scene.line.length[link], self.diameter[link], t)
                weight -= share * self.lift[link] * wet
            lies = False
            if bed is not None:
                lies = nodes[:, 0, 2] < bed + ON_BED
            return force_on_point(direction, tension, weight, lies, np)

    def _wet(self, at: np.ndarray, direction: np.ndarray, length: float, diameter: float, t: np.ndarray) -> np.ndarray:
        """`wet_fraction` (k,) of the part of a link at a point (k, 3) [m]."""
        if np.all(at[:, 2] + length + diameter < self._surface.lowest):
            return np.ones(len(at))
        return wet_fraction(self._surface.over(at[:, None], t)[:, 0], at, direction, length, diameter)


def load_on_fixed_point(
    model: Model, links: tuple[int, ...], signs: tuple[float, ...], r: jax.Array, tension: jax.Array, t: jax.Array
) -> jax.Array:
    """Force (3,) [N] of all lines on a fixed point, differentiable.

    Args:
        links: those that end there; signs: 1 for links that start there, -1 for links that end there.
        r: free nodes (nodes, 3) [m]; tension: of all links (n,) [N]; t: time [s].
    """
    own = np.array(links)
    starts = np.array(signs) > 0.0
    graph = model.geometry
    nodes = graph.everywhere(r, model.ends(t).positions)
    return jnp.sum(end_forces_of_model(model, own, starts, nodes, tension, t), axis=0)


def end_forces_of_model(
    model: Model, links: np.ndarray, starts: np.ndarray, nodes: jax.Array, tension: jax.Array, t: jax.Array
) -> jax.Array:
    """Force (m, 3) [N] of end links on their points, differentiable.

    Args:
        links: the end links (m,); starts: whether each link starts at its point or ends there (m,).
        nodes: all nodes, free ones first (see `Graph.everywhere`) [m]; tension: of all links (n,) [N]; t: time [s].
    """
    line = model.line
    graph = model.geometry
    ends = graph.first[links], graph.last[links]
    at = nodes[np.where(starts, *ends)]
    inner = nodes[np.where(starts, *reversed(ends))]
    along = inner - at
    direction = along / safe_norm(along)[:, None]
    near = jnp.broadcast_to(jnp.asarray(line.near_share, nodes.dtype), line.length.shape)[links]
    share = jnp.where(starts, near, 1.0 - near)
    effects: dict[str, Any] = {effect.name: effect for effect in model.effects}
    if "weight" in effects:
        weight = share * effects["weight"].per_link(line)[links]
    else:
        weight = jnp.zeros_like(share)
    if "buoyancy" in effects and model.sea is not None and line.diameter is not None:
        diameter = jnp.broadcast_to(line.diameter, line.length.shape)[links]
        wet = wet_fraction(model.sea.elevation(at, t), at, direction, share * line.length[links], diameter)
        weight = weight - share * effects["buoyancy"].per_link(model)[links] * wet
    if "seabed" in effects:
        lies = at[:, 2] < effects["seabed"].bed_height(at, rounded=0.0) + ON_BED
    else:
        lies = False
    return force_on_point(direction, tension[links], weight, lies, jnp)
