"""Drag, added mass and wave force on rigid bodies, slice by slice."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import dot, safe_norm
from dropper_jax.effects.body_buoyancy import Pieces, mix_corners, scatter_to_corners
from dropper_jax.model import Effect, Kinematics, ModelView


class Around(NamedTuple):
    """The water at the pieces (p,) and at the ends (e,), frozen over a step: level [m], velocity and acceleration."""

    level: jax.Array
    velocity: jax.Array
    acceleration: jax.Array
    end_level: jax.Array
    end_velocity: jax.Array
    end_acceleration: jax.Array


#: Part of its radius over which a level end enters the water.
END_SLANT = 0.1


@component
class BodyWater(Effect):
    """Morison's forces on each slice of a body, at the centre of its axis; u is relative, V the submerged volume.

    - across: `1/2 rho Cdn D L (V/V0) |u_n| u_n` and `rho V Can u'_n`, added mass `rho V Can`;
    - the undisturbed wave: `rho V u'` (with the buoyancy up to the actual surface in `body_buoyancy`);
    - on ends: `1/2 rho Cdt A |u_t| u_t` along the axis, added mass Cat of a half sphere's water, `rho 2/3 pi (D/2)^3`;
    - on spheres: `1/2 rho Cd A (V/V0) |u| u`, `rho V Ca u'`, added mass `rho V Ca`.

    Moments follow from the positions of the slices. Further diffraction and radiation are not modelled, so bodies must
    be small compared with the wavelength.
    """

    name = "body_water"
    bodily = True
    pieces: Pieces
    cdn: jax.Array = parameter("drag coefficients across slices, and of spheres", unit="-", shape="table", low=0.0)
    can: jax.Array = parameter("added mass coefficients of the same", unit="-", shape="table", low=0.0)
    end: jax.Array = parameter("shares of the ends (e, 4)", unit="-", shape="vectors")
    outward: jax.Array = parameter("shares of the axes' unit vectors there (e, 4)", unit="-", shape="vectors")
    end_radius: jax.Array = parameter("radius of the ends", unit="m", shape="table", low=0.0)
    cdt: jax.Array = parameter("drag coefficients of the ends", unit="-", shape="table", low=0.0)
    cat: jax.Array = parameter("added mass coefficients of the ends", unit="-", shape="table", low=0.0)
    end_of: tuple[int, ...] = option("body of each end", type=tuple, default=())

    def _ends(self, model: ModelView, nodal: jax.Array) -> jax.Array:
        """A nodal field at the ends (e, 3)."""
        return mix_corners(self.end, nodal[self.pieces.body_nodes(model, self.end_of)])

    def _axes(self, k: Kinematics) -> tuple[jax.Array, jax.Array]:
        """Unit vectors along the slices (c, 3) and at the ends (e, 3)."""
        ends = self.pieces.axes(k.model, k.r)
        along = ends[:, 1] - ends[:, 0]
        out = mix_corners(self.outward, k.r[self.pieces.body_nodes(k.model, self.end_of)])
        return along / safe_norm(along)[:, None], out / safe_norm(out)[:, None]

    def _across(self, along: jax.Array, field: jax.Array) -> jax.Array:
        """Components across the slices of vectors (p, 3) at the pieces; the full vectors at spheres."""
        count = along.shape[0]
        return jnp.concatenate([field[:count] - dot(field[:count], along)[:, None] * along, field[count:]])

    def prepare(self, k: Kinematics) -> Around:
        sea = k.sea
        positions = self.pieces.middles(k.model, k.r)
        motion = sea.at(jnp.concatenate([positions, self._ends(k.model, k.r)]), k.t)
        count = positions.shape[0]
        return Around(*(part[at] for at in (slice(None, count), slice(count, None)) for part in motion))

    def _under(self, k: Kinematics, out: jax.Array, level: jax.Array) -> jax.Array:
        """Submerged fraction of the ends (e,)."""
        across = jnp.sqrt(out[:, 0] ** 2 + out[:, 1] ** 2 + END_SLANT**2)
        s = 0.5 + 0.5 * (level - self._ends(k.model, k.r)[:, 2]) / (self.end_radius * across)
        s = jnp.clip(s, 0.0, 1.0)
        return s * s * (3.0 - 2.0 * s)

    def _end_mass(self, density: jax.Array, under: jax.Array) -> jax.Array:
        """Added mass of the ends (e,) [kg]."""
        return density * under * self.cat * 2.0 / 3.0 * jnp.pi * self.end_radius**3

    def _drag_sizes(self) -> tuple[jax.Array, jax.Array]:
        """Frontal areas (p,) [m^2] and volumes (p,) [m^3] of the pieces."""
        radius = self.pieces.radius
        length = self.pieces.length
        ball = self.pieces.ball
        frontal = jnp.concatenate([2.0 * radius * length, jnp.pi * ball**2])
        return frontal, jnp.concatenate([jnp.pi * radius**2 * length, 4.0 / 3.0 * jnp.pi * ball**3])

    def force(self, k: Kinematics) -> jax.Array:
        model = k.model
        around = k.prepared(self)
        pieces = self.pieces
        density = k.sea.density
        along, out, wet, under = self._cut(k)
        u = self._across(along, around.velocity - pieces.middles(model, k.v))
        frontal, volume = self._drag_sizes()
        skin = 0.5 * density * self.cdn * frontal * wet / volume
        drag = (skin * safe_norm(u))[:, None] * u
        swung = around.acceleration + self.can[:, None] * self._across(along, around.acceleration)
        total = pieces.spread(model, drag + density * wet[:, None] * swung)
        if not self.end_of:
            return total
        speed = dot(around.end_velocity - self._ends(model, k.v), out)
        push = 0.5 * density * under * self.cdt * jnp.pi * self.end_radius**2 * jnp.abs(speed) * speed
        push = push + self._end_mass(density, under) * dot(around.end_acceleration, out)
        return total + self._at_ends(model, push[:, None] * out)

    def _at_ends(self, model: ModelView, force: jax.Array) -> jax.Array:
        return scatter_to_corners(self.pieces.body_nodes(model, self.end_of), self.end, force, model.free_nodes)

    def _cut(self, k: Kinematics, levels: tuple[jax.Array, jax.Array] | None = None) -> tuple[jax.Array, ...]:
        """Axes of slices and ends, submerged volumes of pieces (p,) [m^3] and submerged fractions of ends (e,).

        Under the frozen surface, or under `levels` over pieces and ends.
        """

        def find_water() -> tuple[jax.Array, ...]:
            if levels is None:
                level = k.prepared(self).level
                end_level = k.prepared(self).end_level
            else:
                level, end_level = levels
            along, out = self._axes(k)
            return along, out, self.pieces.wet(k.model, k.r, level), self._under(k, out, end_level)

        if levels is None:
            return k.compute_once(self.name, find_water)
        return find_water()

    def inertia(self, k: Kinematics, a: jax.Array) -> jax.Array:
        density = k.sea.density
        along, out, wet, under = self._cut(k)
        across = self._across(along, self.pieces.middles(k.model, a))
        total = self.pieces.spread(k.model, (density * self.can * wet)[:, None] * across)
        if not self.end_of:
            return total
        end_mass = self._end_mass(density, under)
        return total + self._at_ends(k.model, (end_mass * dot(self._ends(k.model, a), out))[:, None] * out)

    def kinetic(self, k: Kinematics) -> jax.Array:
        sea = k.sea
        positions = self.pieces.middles(k.model, k.r)
        levels = sea.elevation(positions, k.t), sea.elevation(self._ends(k.model, k.r), k.t)
        along, out, wet, under = self._cut(k, levels)
        across = self._across(along, self.pieces.middles(k.model, k.v))
        mass = sea.density * self.can * wet
        ends = self._end_mass(sea.density, under) * dot(self._ends(k.model, k.v), out) ** 2
        return 0.5 * (jnp.sum(mass * dot(across, across)) + jnp.sum(ends))
