"""Drag, added mass and wave force on rigid bodies, slice by slice."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import dot, safe_norm
from dropper_jax.effects.body_pieces import Pieces, mix_corners, scatter_to_corners
from dropper_jax.effects.submerged import submerged_fraction
from dropper_jax.model import Effect, Kinematics, ModelView
from dropper_jax.sea import Motion
from dropper_jax.sea.current import Scalar

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
    cdn: Array = parameter("drag coefficients across slices, and of spheres", unit="-", shape="table", low=0.0)
    can: Array = parameter("added mass coefficients of the same", unit="-", shape="table", low=0.0)
    end: Array = parameter("shares of the ends (e, 4)", unit="-", shape="vectors")
    outward: Array = parameter("shares of the axes' unit vectors there (e, 4)", unit="-", shape="vectors")
    end_radius: Array = parameter("radius of the ends", unit="m", shape="table", low=0.0)
    cdt: Array = parameter("drag coefficients of the ends", unit="-", shape="table", low=0.0)
    cat: Array = parameter("added mass coefficients of the ends", unit="-", shape="table", low=0.0)
    end_of: tuple[int, ...] = option("body of each end", type=tuple, default=())

    def _at_ends(self, model: ModelView, weights: Array, nodal: Array) -> Array:
        """A nodal field, with weights of the corners (e, 4), at the ends (e, 3)."""
        return mix_corners(weights, nodal[self._end_nodes(model)])

    def _end_nodes(self, model: ModelView) -> np.ndarray:
        return self.pieces.body_nodes(model, np.array(self.end_of, int))

    def _across(self, along: Array, field: Array) -> Array:
        """Components across the slices of vectors (p, 3) at the pieces; the full vectors at spheres."""
        count = along.shape[0]
        return jnp.concatenate([field[:count] - dot(field[:count], along)[:, None] * along, field[count:]])

    def prepare(self, k: Kinematics) -> tuple[Motion, Motion]:
        """The water at the pieces (p,) and at the ends (e,)."""
        positions = self.pieces.middles(k.model, k.r)
        motion = k.sea.at(jnp.concatenate([positions, self._at_ends(k.model, self.end, k.r)]), k.t)
        count = positions.shape[0]
        return jax.tree.map(lambda x: x[:count], motion), jax.tree.map(lambda x: x[count:], motion)

    def _end_mass(self, density: Scalar, under: Array) -> Array:
        """Added mass of the ends (e,) [kg]."""
        return density * under * self.cat * 2.0 / 3.0 * jnp.pi * self.end_radius**3

    def _drag_sizes(self) -> tuple[Array, Array]:
        """Frontal areas (p,) [m^2] and volumes (p,) [m^3] of the pieces."""
        radius = self.pieces.radius
        length = self.pieces.length
        ball = self.pieces.ball
        frontal = jnp.concatenate([2.0 * radius * length, jnp.pi * ball**2])
        return frontal, jnp.concatenate([jnp.pi * radius**2 * length, 4.0 / 3.0 * jnp.pi * ball**3])

    def force(self, k: Kinematics) -> Array:
        model = k.model
        water, end_water = k.prepared(self)
        density = k.sea.density
        along, out, wet, under = self._cut_by_frozen_surface(k)
        u = self._across(along, water.velocity - self.pieces.middles(model, k.v))
        frontal, volume = self._drag_sizes()
        skin = 0.5 * density * self.cdn * frontal * wet / volume
        drag = (skin * safe_norm(u))[:, None] * u
        swung = water.acceleration + self.can[:, None] * self._across(along, water.acceleration)
        speed = dot(end_water.velocity - self._at_ends(model, self.end, k.v), out)
        push = 0.5 * density * under * self.cdt * jnp.pi * self.end_radius**2 * jnp.abs(speed) * speed
        push = push + self._end_mass(density, under) * dot(end_water.acceleration, out)
        return self._spread(model, drag + density * wet[:, None] * swung, push[:, None] * out)

    def _spread(self, model: ModelView, force: Array, end_force: Array) -> Array:
        """Forces at the pieces (p, 3) and at the ends (e, 3), distributed to the free nodes (free, 3)."""
        ends = scatter_to_corners(self._end_nodes(model), self.end, end_force, model.free_nodes)
        return self.pieces.spread(model, force) + ends

    def _cut(self, k: Kinematics, level: Array, end_level: Array) -> tuple[Array, ...]:
        """Unit vectors along slices (c, 3) and out of ends (e, 3), submerged volumes of pieces (p,) [m^3] and fractions
        of ends (e,), under a surface at these levels over pieces and ends."""
        ends = self.pieces.axes(k.model, k.r)
        along = ends[:, 1] - ends[:, 0]
        out = self._at_ends(k.model, self.outward, k.r)
        out = out / safe_norm(out)[:, None]
        across = jnp.sqrt(out[:, 0] ** 2 + out[:, 1] ** 2 + END_SLANT**2)
        below = end_level - self._at_ends(k.model, self.end, k.r)[:, 2]
        under = submerged_fraction(below, 2.0 * self.end_radius * across)
        return along / safe_norm(along)[:, None], out, self.pieces.wet(k.model, k.r, level), under

    def _cut_by_frozen_surface(self, k: Kinematics) -> tuple[Array, ...]:
        water, end_water = k.prepared(self)
        return k.compute_once(self.name, lambda: self._cut(k, water.elevation, end_water.elevation))

    def inertia(self, k: Kinematics, a: Array) -> Array:
        density = k.sea.density
        along, out, wet, under = self._cut_by_frozen_surface(k)
        across = self._across(along, self.pieces.middles(k.model, a))
        ends = self._end_mass(density, under) * dot(self._at_ends(k.model, self.end, a), out)
        return self._spread(k.model, (density * self.can * wet)[:, None] * across, ends[:, None] * out)

    def kinetic(self, k: Kinematics) -> Array:
        sea = k.sea
        level = sea.elevation(self.pieces.middles(k.model, k.r), k.t)
        along, out, wet, under = self._cut(k, level, sea.elevation(self._at_ends(k.model, self.end, k.r), k.t))
        across = self._across(along, self.pieces.middles(k.model, k.v))
        mass = sea.density * self.can * wet
        ends = self._end_mass(sea.density, under) * dot(self._at_ends(k.model, self.end, k.v), out) ** 2
        return 0.5 * (jnp.sum(mass * dot(across, across)) + jnp.sum(ends))
