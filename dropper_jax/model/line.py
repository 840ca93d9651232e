"""Points, and the line of links between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp

from dropper_jax.axial import AxialLaw, Rigid
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.model.failures import Failures
from dropper_jax.model.shares import Part, PathPart


@component
class Point:
    """Where lines begin and end. `fixed` points stay (or follow an end motion), a `free` one moves with the line."""

    position: jax.Array = parameter("position", unit="m", shape="vector")
    name: str = option("name", type=str, default="")
    kind: str = option("fixed or free", choices=("fixed", "free"), default="fixed")


@component
class Line:
    """A path of n links between two points; node j = 1..n is the far node of link j.

    Point-mass links carry `mass[j]` on node j. Compound links (`centre_of_mass` given) are rods with their centre
    of mass at y from their first node and inertia I about it; with J = I + m y^2 each has the constant nodal mass
    `M11 = m - 2 m y/L + J/L^2, M12 = m y/L - J/L^2, M22 = J/L^2` (times the 3x3 unit matrix; no spin).
    """

    length: jax.Array = parameter("length of each link", unit="m", shape="link", low=0.0, open_low=True)
    mass: jax.Array = parameter("mass of each link", unit="kg", shape="link", low=0.0, open_low=True)
    centre_of_mass: jax.Array | None = parameter(
        "distance of the centre of mass from the link's first node", unit="m", shape="link", low=0.0, optional=True
    )
    inertia: jax.Array | None = parameter(
        "moment of inertia about the centre of mass", unit="kg m^2", shape="link", low=0.0, optional=True
    )
    diameter: jax.Array | None = parameter(
        "diameter of the displaced volume", unit="m", shape="link", low=0.0, open_low=True, optional=True
    )
    axial: AxialLaw = Rigid()
    failures: Failures | None = None
    name: str = option("name", type=str, default="line")
    start: int = option("index of the first point", type=int, default=0)
    end: int = option("index of the last point", type=int, default=1)

    @property
    def links(self) -> int:
        return self.length.shape[-1]

    @property
    def compound(self) -> bool:
        return self.centre_of_mass is not None

    @property
    def volume(self) -> jax.Array:
        """Displaced volume of each link (n,) [m^3]."""
        return 0.25 * jnp.pi * self.diameter**2 * self.length

    @property
    def second_moment(self) -> jax.Array:
        """J = I + m y^2 about the first node (n,) [kg m^2]."""
        return self.inertia + self.mass * self.centre_of_mass**2

    def blocks(self) -> tuple[jax.Array, jax.Array, jax.Array]:
        """M11, M12, M22 of every link, each (n,) [kg]."""
        if not self.compound:
            zero = jnp.zeros_like(self.mass)
            return zero, zero, self.mass
        ratio = self.centre_of_mass / self.length
        turn = self.second_moment / self.length**2
        return self.mass * (1 - 2 * ratio) + turn, self.mass * ratio - turn, turn

    def node_share(self, per_link: jax.Array, free: int) -> jax.Array:
        """What acts in the links' centres of mass, shared to the free nodes (free,)."""
        if not self.compound:
            return per_link[:free]
        ratio = self.centre_of_mass / self.length
        far, near = per_link * ratio, per_link * (1 - ratio)
        near = jnp.concatenate([near[1:], jnp.zeros_like(near[:1])])
        return (far + near)[:free]

    def node_mass(self, free: int) -> jax.Array:
        """Diagonal of the mass matrix on the free nodes (free,) [kg]."""
        first, _, last = self.blocks()
        if not self.compound:
            return last[:free]
        return (last + jnp.concatenate([first[1:], jnp.zeros_like(first[:1])]))[:free]

    def parts(self, free: int) -> Iterator[Part]:
        """Which share of the links' water forces acts on which free node (see `effects.wetting`)."""
        # the far ends of the links and, where links are compound, their near ends
        if not self.compound:
            yield PathPart(1.0, 0, free)
            return
        ratio = self.centre_of_mass / self.length
        yield PathPart(ratio[:free], 0, free)
        near = PathPart(1.0, 1, free)
        yield replace(near, share=near.take(1.0 - ratio))

    def inertia_force(self, a: jax.Array, start: jax.Array | None, end: jax.Array | None, held: bool) -> jax.Array:
        """M a on the free nodes (free, 3) for nodal accelerations a and those of the ends (None: at rest)."""
        diagonal = self.node_mass(a.shape[0])[:, None] * a
        if not self.compound:
            return diagonal
        _, coupling, _ = self.blocks()
        zero = jnp.zeros_like(a[:1])
        before = jnp.concatenate([zero if start is None else start[None], a[:-1]])
        after = jnp.concatenate([a[1:], zero if end is None or not held else end[None]])
        free = a.shape[0]
        next_coupling = jnp.concatenate([coupling[1:], jnp.zeros_like(coupling[:1])])[:free]
        return diagonal + coupling[:free, None] * before + next_coupling[:, None] * after
