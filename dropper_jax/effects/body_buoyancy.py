"""Buoyancy of rigid bodies up to the water surface."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.fields import component
from dropper_jax.effects.body_pieces import Pieces
from dropper_jax.model import Effect, Kinematics

#: Gauss-Legendre points over the displacement of a step, from -1/2 to 1/2, and their weights.
GAUSS_POINTS = 0.5 * np.sqrt(0.6) * np.array([-1.0, 0.0, 1.0])
GAUSS_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


@component
class BodyBuoyancy(Effect):
    """Buoyancy `F = -dU/dr` with `U = rho g int max(-z, 0) dV`, in water whose surface is z = 0
    (`effects.hydrostatics`).

    It includes the waterplane stiffness and the metacentre at every tilt. Over a step it is the mean along the straight
    path of the corners (average vector field; Quispel and McLaren 2008), which conserves energy.
    """

    name = "body_buoyancy"
    bodily = True
    pieces: Pieces

    def _level(self, k: Kinematics) -> Array:
        return jnp.zeros(len(self.pieces.owners), k.r.dtype)

    def force(self, k: Kinematics) -> Array:
        size = k.sea.density * k.sea.gravity

        def force_at(r: Array) -> Array:
            return size * self.pieces.push(k.model, r, self._level(k))

        if k.h is None:
            return force_at(k.r)
        along = jnp.asarray(GAUSS_POINTS, k.r.dtype)[:, None, None] * (k.h * k.v)
        return jnp.sum(jnp.asarray(GAUSS_WEIGHTS, k.r.dtype)[:, None, None] * jax.vmap(force_at)(k.r + along), axis=0)

    def potential(self, k: Kinematics) -> Array:
        return k.sea.density * k.sea.gravity * self.pieces.energy(k.model, k.r, self._level(k))


@component
class BodyBuoyancyInWaves(Effect):
    """The same for slices under the actual surface over each of them, in waves or a tide; its work is recorded.

    The dynamic pressure of waves is included in the `rho V u'` of `body_water` and is not added again.
    """

    name = "body_buoyancy"
    bodily = True
    pieces: Pieces

    def prepare(self, k: Kinematics) -> Array:
        """Elevation (c + s,) [m] of the surface over the pieces."""
        return k.sea.elevation(self.pieces.middles(k.model, k.r), k.t)

    def force(self, k: Kinematics) -> Array:
        sea = k.sea
        return sea.density * sea.gravity * self.pieces.push(k.model, k.r, k.prepared(self))
