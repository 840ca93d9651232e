"""Signals of a motion in time: their units, and their values at one instant.

Conventions: z points upwards, and the still water surface is z = 0. Links, nodes and modes are numbered from 0 here,
from 1 in names. Nodes are numbered as in `Graph.everywhere`: the free ones first, then the fixed points. The angle of a
link is that of the vector from its first to its last node, below the horizontal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.numerics import horizontal_norm, safe_norm
from dropper_jax.model import Model, Parted
from dropper_jax.model.slots import LengthOverTime, Stateful
from dropper_jax.quantities.end_links import load_on_fixed_point
from dropper_jax.quantities.statistics import PERIOD
from dropper_jax.stepping.observe import observe


class Signal(NamedTuple):
    """Unit of a signal, and what WHERE in the name of a quantity selects (None: nothing)."""

    unit: str
    where: str | None


SIGNALS = {
    "tension": Signal("N", "link"),  # tension of a link; of a line or of all links the highest
    "anchor": Signal("N", "anchor"),  # force of the lines on a fixed point
    "angle": Signal("rad", "link"),  # angle of a link from the horizontal, positive downwards, -pi/2 to pi/2
    "line": Signal("N", "end"),  # tension [N] or angle [rad] of a line at an end, upwards positive
    "curvature": Signal("1/m", "line"),  # change of direction per length between two links, the highest of a line
    "offset": Signal("m", "node"),  # horizontal distance of a point from its position in the scene
    "excursion": Signal("m", "node"),  # distance of a free node from its start position; without a number the maximum
    "depth": Signal("m", "node"),  # depth of a point below z = 0
    "x": Signal("m", "node"),  # position of a node
    "y": Signal("m", "node"),  # position of a node
    "z": Signal("m", "node"),  # position of a node
    PERIOD: Signal("s", "mode"),  # natural period about the static pose, the longest first; of the start alone
    "energy": Signal("J", None),  # kinetic and potential energy
}
#: Signals of all links or nodes at once.
OF_ALL = ("tension", "excursion", "energy")
#: Parts of the force on a fixed point: its horizontal size, its upward component and its size [N]; its angle above the
#: horizontal [rad].
DIRECTIONS = ("horizontal", "vertical", "total", "uplift")


@dataclass(frozen=True)
class Instant:
    """One instant of a motion.

    Attributes:
        model: of the motion.
        start: free nodes (nodes, 3) [m] at the start of the motion, from which excursions count.
        r, v: free nodes (nodes, 3) [m], [m/s].
        tension: of the links (n,) [N].
        t: time [s].
        parted: broken links; None if nothing can break.
    """

    model: Model
    start: Array
    r: Array
    v: Array
    tension: Array
    t: Array
    parted: Parted | None = None

    @property
    def links(self) -> Array:
        """Link vectors (n, 3) [m]."""
        return self.model.links(self.r, self.model.ends(self.t))

    def all_nodes(self, free: Array) -> Array:
        """Positions (nodes, 3) [m] of free nodes, followed by the fixed points at this instant."""
        return self.model.geometry.everywhere(free, self.model.ends(self.t).positions)

    def energy(self) -> Array:
        """Kinetic and potential energy (1,) [J].

        Raises:
            SceneError: winches have set lengths, which the instant does not contain.
        """
        if any(isinstance(effect, Stateful) for effect in self.model.effects_with(LengthOverTime)):
            raise SceneError(
                "energy: depends on the lengths that winches have set, which this quantity does not have; "
                "allowed: in scenes whose line.length_in_time are tables"
            )
        observed = observe(self.model, self.r, self.v, self.t, self.parted)
        return (observed.kinetic + observed.potential)[None]

    def anchor_load(self, links: tuple[int, ...], signs: tuple[float, ...], direction: str) -> Array:
        """One of the `DIRECTIONS` (1,) of the force of the lines on a fixed point.

        Args:
            links: those that end there.
            signs: 1 for links that start there, -1 for links that end there.
        """
        force = load_on_fixed_point(self.model, links, signs, self.r, self.tension, self.t)
        if direction == "vertical":
            return force[2:]
        if direction == "total":
            return safe_norm(force)[None]
        across = horizontal_norm(force)[None]
        if direction == "uplift":
            return jnp.arctan2(force[2:], across)
        return across

    def link_angles(self) -> Array:
        """Angles (n,) [rad] of the links below the horizontal, -pi/2 to pi/2."""
        links = self.links
        return jnp.arctan2(-links[:, 2], horizontal_norm(links))

    def curvatures(self) -> Array:
        """Change of direction per unstretched length (n - 1,) [1/m] between each link and the next one."""
        links = self.links
        length = self.model.line.length
        along = links / safe_norm(links)[:, None]
        return safe_norm(along[1:] - along[:-1]) / (0.5 * (length[1:] + length[:-1]))

    def node_signal(self, signal: str, members: tuple[int, ...] | None, point: int) -> Array:
        """A signal of the free nodes, or of all nodes if a member is a fixed point (nodes,) [m].

        Args:
            members: the nodes that are needed; None for the free ones.
            point: number of the point, of an offset.
        """
        r = self.r
        start = self.start
        if members is not None and max(members) >= len(r):
            r = self.all_nodes(r)
            start = self.all_nodes(start)
        if signal == "excursion":
            return safe_norm(r - start)
        if signal == "offset":
            return horizontal_norm(r - self.model.points[point].position)
        if signal == "depth":
            return -r[:, 2]
        return r[:, "xyz".index(signal)]


#: Signals of links (n,), or of pairs of neighbouring links (n - 1,), by name.
OF_LINKS: dict[str, Callable[[Instant], Array]] = {
    "tension": lambda now: now.tension,
    "angle": Instant.link_angles,
    "curvature": Instant.curvatures,
}


def signal_members(found: Array, members: tuple[int, ...] | None, signs: tuple[float, ...]) -> Array:
    """The members (m,) of a signal, all if None, each times its sign if there are signs."""
    if members is not None:
        found = found[np.array(members)]
    if signs:
        return found * np.array(signs)
    return found
