"""Points, the line of links between them, and the failures of its links."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.axial import AxialLaw, Rigid
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.model.graph import Graph, LinkEnd, take


@component
class Failures:
    """Failures, m entries: loads (m, n) [N], infinite for links that an entry does not watch; times (m,) [s] or
    infinite.

    `named` holds the index of the link that an entry specifies, -1 for the most loaded one.
    """

    load: Array
    time: Array
    named: tuple[int, ...] = option("links specified by the entries", default=())


@component
class Point:
    """Points where lines start and end. `fixed` points stay (or follow an end motion), a `free` one moves with the
    line."""

    position: Array = parameter("position", unit="m", shape="vector")
    name: str = option("name", type=str, default="")
    kind: str = option("fixed or free", choices=("fixed", "free"), default="fixed")


@component
class Line:
    """The links of all lines, line after line, in arrays (n,); `geometry` describes how they are joined.

    Point-mass links carry their mass on nodes, as distributed by the geometry. Compound links (`centre_of_mass` given)
    are rods with their centre of mass at y from their first node and inertia I about it. With J = I + m y^2 each has
    the constant nodal mass `M11 = m - 2 m y/L + J/L^2, M12 = m y/L - J/L^2, M22 = J/L^2` (times the 3x3 unit matrix; no
    spin).
    """

    length: Array = parameter("length of each link", unit="m", shape="link", above=0.0)
    mass: Array = parameter("mass of each link", unit="kg", shape="link", above=0.0)
    geometry: Graph = option("how nodes, links and points belong together")
    centre_of_mass: Array | None = parameter(
        "distance of the centre of mass from the link's first node", unit="m", shape="link", low=0.0, default=None
    )
    inertia: Array | None = parameter(
        "moment of inertia about the centre of mass", unit="kg m^2", shape="link", low=0.0, default=None
    )
    diameter: Array | None = parameter(
        "diameter of the displaced volume", unit="m", shape="link", above=0.0, default=None
    )
    outer_diameter: Array | None = parameter(
        "diameter for drag and added mass (default: that of the displaced volume)",
        unit="m",
        shape="link",
        above=0.0,
        default=None,
    )
    axial: AxialLaw = Rigid()
    failures: Failures | None = None
    name: str = option("name", type=str, default="line")

    @property
    def links(self) -> int:
        return self.length.shape[-1]

    @property
    def compound(self) -> bool:
        return self.centre_of_mass is not None

    @property
    def volume(self) -> Array:
        """Displaced volume of each link (n,) [m^3]."""
        return 0.25 * jnp.pi * self.needed_diameter**2 * self.length

    @property
    def needed_diameter(self) -> Array:
        """Diameter of the displaced volume (n,) [m].

        Raises:
            ValueError: a line has none.
        """
        if self.diameter is None:
            raise ValueError(
                "line.diameter: missing; forces of the water and of the seabed need that of every line [m]"
            )
        return self.diameter

    @property
    def drag_diameter(self) -> Array:
        """Diameter for drag and added mass of each link (n,) [m]."""
        if self.outer_diameter is None:
            return self.needed_diameter
        return self.outer_diameter

    def blocks(self) -> tuple[Array, Array, Array]:
        """M11, M12, M22 of every compound link, each (n,) [kg]."""
        if self.centre_of_mass is None or self.inertia is None:
            raise ValueError("line.centre_of_mass, line.inertia: links are compound with both, point masses without")
        ratio = self.centre_of_mass / self.length
        second_moment = self.inertia + self.mass * self.centre_of_mass**2
        turn = second_moment / self.length**2
        return self.mass * (1 - 2 * ratio) + turn, self.mass * ratio - turn, turn

    @property
    def near_share(self) -> Array | np.ndarray | float:
        """Fraction of each link's weight (n,) at its first node; one number if all are the same."""
        if self.centre_of_mass is None:
            return self.geometry.near_share
        return 1.0 - self.centre_of_mass / self.length

    def node_share(self, per_link: Array) -> Array:
        """Values acting at the links' centres of mass, distributed to the free nodes (free,)."""
        near = self.near_share
        return self.geometry.at_ends(near * per_link, (1.0 - near) * per_link)

    @property
    def node_mass(self) -> Array:
        """Diagonal of the mass matrix on the free nodes (free,) [kg]."""
        if not self.compound:
            return self.node_share(self.mass)
        first, _, last = self.blocks()
        return self.geometry.at_ends(first, last)

    def link_ends(self) -> tuple[LinkEnd, ...]:
        """The ends of links on which water forces act, with their shares (see `effects.submerged.wet_share`)."""
        near = self.near_share
        far = LinkEnd(self.geometry, True, 1.0 - near)
        if isinstance(near, float) and near == 0.0:
            return (far,)
        return far, LinkEnd(self.geometry, False, near)

    def inertia_forces(self, a: Array, ends: Array | None) -> tuple[Array, Array]:
        """M a of compound links at their first and at their last nodes, (n, 3) each, for accelerations of nodes and
        ends (None: 0)."""
        geometry = self.geometry
        field = geometry.everywhere(a, ends)
        first, last = take(field, geometry.first), take(field, geometry.last)
        own, coupling, other = (block[:, None] for block in self.blocks())
        return own * first + coupling * last, coupling * first + other * last
