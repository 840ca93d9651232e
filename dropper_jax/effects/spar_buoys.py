"""Upright cylinders that do not rotate: spar buoys at points, up to the actual surface."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.indexed_sums import scatter_add
from dropper_jax.base.numerics import dot, safe_norm
from dropper_jax.model import Effect, Kinematics, ModelView
from dropper_jax.sea import Motion, Sea

#: Gauss-Legendre points over the draught, from 0 to 1, and their weights: three integrate a wave over 10 m to 1e-4.
GAUSS_POINTS = np.array([0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15)])
GAUSS_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
#: Part of the height over which the buoy's ends enter and leave the water smoothly.
EDGE_SHARE = 0.02


@component
class SparBuoys(Effect):
    """Vertical cylinders with three translations (paper 3.2.6), from `[[buoy]]`; their point is `attachment` above the
    base. On the seabed it is the point that touches, not the base.

    With the draught `w = eta - z_base`, between 0 and the height H, and means <> over it:

    - weight `-m g`; buoyancy `rho g A w` (A = pi D^2/4) to the actual surface, and `rho A w <u'_z>`. Together, to first
    order on a fixed buoy, these are the pressure on its base, `rho g A a cosh(k(d + z_base))/cosh(kd)`; the dynamic
    pressure is not added again;
    - across: `1/2 rho Cdn D w <|u| u>` and `rho A w (1 + Can) <u'>`, u relative; drag acts on D w, the wet part of the
    projected area D H;
    - along: `1/2 rho Cdt A |u_z| u_z`, with u_z of the lowest of three points over the draught, 0.11 w above the base;
    - added mass `rho A w Can` across. Along the axis it belongs to the end: `Cat` times the water of a half sphere on
    the base, `rho (2/3) pi (D/2)^3`. With `end_added_mass = "volume"` it is that of the submerged volume, as in the
    paper (66 kg against 793 kg for its buoy). Its force on the right is `M_a u'_z` at that lowest point.
    """

    name = "spar_buoys"
    mass: Array = parameter("mass", unit="kg", shape="table", above=0.0)
    diameter: Array = parameter("diameter", unit="m", shape="table", above=0.0)
    height: Array = parameter("height", unit="m", shape="table", above=0.0)
    attachment: Array = parameter("height of the point above the base", unit="m", shape="table", low=0.0)
    cdn: Array = parameter("drag coefficient across", unit="-", shape="table", low=0.0)
    cdt: Array = parameter("drag coefficient of the base", unit="-", shape="table", low=0.0)
    can: Array = parameter("added mass coefficient across", unit="-", shape="table", low=0.0)
    cat: Array = parameter("added mass coefficient of the base", unit="-", shape="table", low=0.0)
    gravity: Array = parameter("acceleration of gravity", unit="m/s^2", low=0.0, default=GRAVITY)
    points: tuple[int, ...] = option("numbers of the points", type=tuple, default=())
    end_added_mass: str = option("of the base", choices=("hemisphere", "volume"), default="hemisphere")

    def nodes(self, model: ModelView) -> np.ndarray:
        """Free node of each buoy."""
        return model.geometry.point_node[list(self.points)]

    @property
    def area(self) -> Array:
        """Waterplane (buoys,) [m^2]."""
        return 0.25 * jnp.pi * self.diameter**2

    def point_mass(self, model: ModelView) -> Array:
        return scatter_add(self.nodes(model), self.mass, model.free_nodes)

    def contact_area(self, model: ModelView) -> Array:
        """Plan area on the seabed (nodes,) [m^2]."""
        return scatter_add(self.nodes(model), self.area, model.free_nodes)

    def _submerged_height(self, r: Array, elevation: Array) -> Array:
        """Submerged height (buoys,) [m] of buoys whose points are at r (buoys, 3), smooth at either end."""
        return _round_to_unit((elevation - (r[:, 2] - self.attachment)) / self.height) * self.height

    def prepare(self, k: Kinematics) -> Motion:
        """The water along the buoys: elevation (buoys,), velocity and acceleration (buoys, 3, 3)."""
        r = k.r[self.nodes(k.model)]
        elevation = k.sea.elevation(r, k.t)
        above = self._submerged_height(r, elevation)[:, None] * jnp.asarray(GAUSS_POINTS, r.dtype)
        heights = (r[:, 2] - self.attachment)[:, None] + above
        x = jnp.broadcast_to(r[:, 0:1], heights.shape)
        y = jnp.broadcast_to(r[:, 1:2], heights.shape)
        positions = jnp.stack([x, y, heights], axis=-1)
        motion = k.sea.at(positions.reshape(-1, 3), k.t)
        velocity = motion.velocity.reshape(positions.shape)
        acceleration = motion.acceleration.reshape(positions.shape)
        return Motion(elevation, velocity, acceleration)

    def force(self, k: Kinematics) -> Array:
        nodes = self.nodes(k.model)
        sea = k.sea
        around = k.prepared(self)
        v = k.v[nodes]
        wet = self._submerged_height(k.r[nodes], around.elevation)
        # weight, hydrostatics and inertia of the water
        displaced = sea.density * self.area * wet
        mean = jnp.sum(jnp.asarray(GAUSS_WEIGHTS, v.dtype)[:, None] * around.acceleration, axis=1)
        lift = displaced * (sea.gravity + mean[:, 2]) - self.mass * self.gravity
        lift = lift + self._end_mass(sea, wet) * around.acceleration[:, 0, 2]
        across = (displaced * (1.0 + self.can))[:, None] * mean[:, :2]
        # drag
        u = around.velocity - v[:, None, :]
        level = jnp.concatenate([u[..., :2], jnp.zeros_like(u[..., :1])], axis=-1)
        weights = jnp.asarray(GAUSS_WEIGHTS, v.dtype) * safe_norm(level)
        pressed = jnp.sum(weights[..., None] * u[..., :2], axis=1)
        drag = (0.5 * sea.density * self.cdn * self.diameter * wet)[:, None] * pressed
        base = u[:, 0, 2]
        heave = 0.5 * sea.density * self.cdt * self.area * self._base_share(wet) * jnp.abs(base) * base
        return scatter_add(nodes, jnp.concatenate([across + drag, (lift + heave)[:, None]], axis=1), k.free)

    def _base_share(self, wet: Array) -> Array:
        """Submerged fraction of the base (buoys,)."""
        return jnp.clip(wet / (EDGE_SHARE * self.height), 0.0, 1.0)

    def _end_mass(self, sea: Sea, wet: Array) -> Array:
        """Added mass along (buoys,) [kg]."""
        if self.end_added_mass == "volume":
            return sea.density * self.cat * self.area * wet
        return sea.density * self.cat * self._base_share(wet) * jnp.pi / 12.0 * self.diameter**3

    def _added_mass(self, sea: Sea, wet: Array) -> Array:
        """Added mass per direction (buoys, 3) [kg]."""
        across = sea.density * self.area * wet * self.can
        return jnp.stack([across, across, self._end_mass(sea, wet)], axis=-1)

    def inertia(self, k: Kinematics, a: Array) -> Array:
        nodes = self.nodes(k.model)
        wet = self._submerged_height(k.r[nodes], k.prepared(self).elevation)
        return scatter_add(nodes, self._added_mass(k.sea, wet) * a[nodes], k.free)

    def kinetic(self, k: Kinematics) -> Array:
        nodes = self.nodes(k.model)
        wet = self._submerged_height(k.r[nodes], k.sea.elevation(k.r[nodes], k.t))
        return 0.5 * jnp.sum(dot(self._added_mass(k.sea, wet) * k.v[nodes], k.v[nodes]))


def _round_to_unit(s: Array) -> Array:
    """s clipped to 0 to 1, with corners rounded over `EDGE_SHARE` (quadratic there, exact elsewhere)."""
    low = jnp.where(s < EDGE_SHARE, jnp.clip(s + EDGE_SHARE, 0.0, 2 * EDGE_SHARE) ** 2 / (4 * EDGE_SHARE), s)
    high = 1.0 - jnp.clip(1.0 + EDGE_SHARE - s, 0.0, 2 * EDGE_SHARE) ** 2 / (4 * EDGE_SHARE)
    return jnp.where(s > 1.0 - EDGE_SHARE, high, low)
