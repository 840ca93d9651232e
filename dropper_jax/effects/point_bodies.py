"""Masses and volumes at points: clump weights, small floats, connectors."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.indexed_sums import scatter_add
from dropper_jax.base.numerics import safe_norm, upright
from dropper_jax.effects.submerged import submerged_fraction
from dropper_jax.model import Effect, Kinematics, ModelView

#: Minimum diameter [m] over which a body enters the water: drag on one without volume would jump at the surface.
SMALLEST_DIAMETER = 1e-2


@component
class PointBodies(Effect):
    """Bodies without rotation at free points, as MoorDyn's points; created from the keys of the points.

    Weight `-m g`, buoyancy `rho g V w`, drag `1/2 rho CdA w |u| u` on the relative velocity, inertia
    `rho V w (1 + Ca) u'` on the right and `rho V w Ca` on the left. w is the submerged fraction of a sphere of volume
    V, smoothed as for lines. Forces act at the point, also that of the seabed: a body sinks in by half its height.
    """

    name = "point_bodies"
    mass: Array = parameter("mass of each body", unit="kg", shape="table", low=0.0)
    volume: Array = parameter("displaced volume", unit="m^3", shape="table", low=0.0)
    drag_area: Array = parameter("drag coefficient times area", unit="m^2", shape="table", low=0.0)
    added_mass: Array = parameter("added mass coefficient Ca", unit="-", shape="table", low=0.0)
    gravity: Array = parameter("acceleration of gravity", unit="m/s^2", low=0.0, default=GRAVITY)
    points: tuple[int, ...] = option("numbers of the points", type=tuple, default=())

    def nodes(self, model: ModelView) -> np.ndarray:
        """Free node of each body."""
        return model.geometry.point_node[list(self.points)]

    def _diameter(self) -> Array:
        """Diameters (bodies,) [m] over which bodies enter the water."""
        return jnp.cbrt(jnp.maximum(6.0 * self.volume / jnp.pi, SMALLEST_DIAMETER**3))

    def _at_bodies(self, model: ModelView, per_body: Array) -> Array:
        """Values of the bodies on the free nodes."""
        return scatter_add(self.nodes(model), per_body, model.free_nodes)

    def point_mass(self, model: ModelView) -> Array:
        return self._at_bodies(model, self.mass)

    def contact_area(self, model: ModelView) -> Array:
        """Plan area on the seabed (nodes,) [m^2]: that of a sphere of the same volume, none of a body without one."""
        has_volume = self.volume > 0.0
        cube = jnp.where(has_volume, 6.0 * self.volume / jnp.pi, 1.0)
        return self._at_bodies(model, jnp.where(has_volume, 0.25 * jnp.pi * jnp.cbrt(cube) ** 2, 0.0))

    def _wet_share(self, k: Kinematics, elevation: Array) -> Array:
        """Submerged fraction (bodies,) under a surface at the bodies (bodies,) [m]."""
        return submerged_fraction(elevation - k.r[self.nodes(k.model), 2], self._diameter())

    def _wet_mass(self, k: Kinematics, elevation: Array) -> Array:
        """Mass of the displaced water (bodies,) [kg] under a surface at the bodies (bodies,) [m]."""
        return k.sea.density * self.volume * self._wet_share(k, elevation)

    def _loads(self, k: Kinematics) -> Array:
        """Forces on the bodies (bodies, 3) [N]."""
        return upright(-self.mass * self.gravity)

    def force(self, k: Kinematics) -> Array:
        return self._at_bodies(k.model, self._loads(k))


@component
class WetPointBodies(PointBodies):
    """The same in water."""

    needs_water = True

    def _loads(self, k: Kinematics) -> Array:
        nodes = self.nodes(k.model)
        water = k.water.motion
        elevation = water.elevation[nodes]
        displaced = self._wet_mass(k, elevation)
        u = water.velocity[nodes] - k.v[nodes]
        drag = 0.5 * k.sea.density * self.drag_area * self._wet_share(k, elevation) * safe_norm(u)
        total = super()._loads(k) + upright(displaced * k.sea.gravity) + drag[:, None] * u
        return total + ((1.0 + self.added_mass) * displaced)[:, None] * water.acceleration[nodes]


@component
class PointBodiesWithAddedMass(WetPointBodies):
    """The same with added mass: only used if a body in the water has it."""

    def inertia(self, k: Kinematics, a: Array) -> Array:
        nodes = self.nodes(k.model)
        mass = self.added_mass * self._wet_mass(k, k.water.motion.elevation[nodes])
        return self._at_bodies(k.model, mass[:, None] * a[nodes])

    def kinetic(self, k: Kinematics) -> Array:
        nodes = self.nodes(k.model)
        mass = self.added_mass * self._wet_mass(k, k.sea.elevation(k.r[nodes], k.t))
        return 0.5 * jnp.sum(mass[:, None] * k.v[nodes] ** 2)
