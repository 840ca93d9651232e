"""Contact and friction of rigid bodies on the seabed, at the ends of their slices and under their spheres."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.fields import component, parameter
from dropper_jax.base.numerics import dot, safe_norm, trace_once, upright
from dropper_jax.effects.body_pieces import Pieces
from dropper_jax.effects.seabed import Seabed
from dropper_jax.model import Effect, Kinematics, ModelView

#: Sine of the tilt [-] below which a circle counts as nearly level; its deepest point could then be any point on it.
LEVEL_TILT = 1e-2
#: Reach of a circle below its centre over its radius [-], as smoothed, where its axis is level.
REACH_WHEN_FLAT = math.sqrt(1.0 + LEVEL_TILT**2) - LEVEL_TILT


@component
class BodyBed(Effect):
    """Normal force on the deepest point of the circle at each end of a slice, and of each sphere; no friction.

    With p the depth of that point below the seabed, along its normal: `N = A (k p + clip(c p', -k p, k p))` as for
    nodes (`effects.seabed` gives k, c and the seabed). A is half the plan area `D L/2` of a slice, or `pi R^2` of a
    sphere. Forces on the corners are `-N dp/dr`, moments included. A circle of radius R about an axis tilted by t from
    upright reaches `R sin t` below its centre. Here this is `R (sqrt(sin^2 t + s^2) - s)/(sqrt(1 + s^2) - s)`, s =
    0.01, which is smooth if the body stands upright.
    """

    name = "body_bed"
    bodily = True
    bed: Seabed
    pieces: Pieces

    @trace_once
    def depths(self, model: ModelView, r: Array) -> Array:
        """Depth of the points (2 c + s,) below the seabed along its normal [m], negative above it."""
        ends = self.pieces.axes(model, r)
        along = ends[:, 1] - ends[:, 0]
        tilt = along[:, :2] / safe_norm(along)[:, None]
        reach = self.pieces.radius * (jnp.sqrt(jnp.sum(tilt**2, axis=1) + LEVEL_TILT**2) - LEVEL_TILT) / REACH_WHEN_FLAT
        positions = self.pieces.points(model, r)
        below = jnp.concatenate([reach, reach, self.pieces.ball])
        return (self.bed.bed_height(positions) - positions[:, 2] + below) * self.bed.upward(positions)[..., 2]

    def _rates(self, k: Kinematics) -> tuple[Array, Array]:
        """Depths [m] and their rates of increase [m/s]."""
        return jax.jvp(lambda r: self.depths(k.model, r), (k.r,), (k.v,))

    def prepare(self, k: Kinematics) -> Array:
        """Downward speed of the points at the start of the step (2 c + s,) [m/s]."""
        return self._rates(k)[1]

    def normal(self, k: Kinematics) -> Array:
        """Contact forces of the points (2 c + s,) [N]."""
        half = self.pieces.radius * self.pieces.length
        area = jnp.concatenate([half, half, jnp.pi * self.pieces.ball**2])
        return area * self.bed.pressure(k, self, *self._rates(k))

    def force(self, k: Kinematics) -> Array:
        return self._contact_force(k, self.normal(k))

    def _contact_force(self, k: Kinematics, normal: Array) -> Array:
        _, back = jax.vjp(lambda r: self.depths(k.model, r), k.r)
        return -back(normal)[0]


#: Speed below which friction decreases [m/s]: a body under a steady force below its friction limit creeps more slowly.
CREEP_SPEED = 1e-3


@component
class BodyBedFriction(BodyBed):
    """The same with dry friction `-mu N s/sqrt(|s|^2 + s0^2)`, s the velocity along the seabed at the contact point.

    That is the velocity of the body's own point there, `x' + w x d`: a rolling ball is not braked, a drum that turns on
    the spot is. Friction only takes energy. It is smooth in s, with s0 = 1 mm/s: it slows and holds the body, except
    for creep below s0.
    """

    friction: Array = parameter("coefficient of each point", unit="-", low=0.0, shape="table")

    def slips(self, model: ModelView, r: Array, v: Array) -> Array:
        """Velocities (2 c + s, 3) [m/s] along the seabed of the contact points; linear in v (free nodes, 3)."""
        pieces = self.pieces
        ends = pieces.axes(model, r)
        along = ends[:, 1] - ends[:, 0]
        along = along / safe_norm(along)[:, None]
        # from the centre of the circle down along its plane, to its edge
        down = along * along[:, 2:] - jnp.array([0.0, 0.0, 1.0], r.dtype)
        arm = pieces.radius[:, None] * down / jnp.sqrt(dot(down, down) + LEVEL_TILT**2)[:, None]
        turned = self._rotation_velocity(model, r, v, jnp.concatenate([arm, upright(-pieces.ball)]))
        velocity = pieces.points(model, v) + turned[pieces.piece_of_point]
        up = self.bed.upward(pieces.points(model, r))
        return velocity - dot(velocity, up)[:, None] * up

    def _rotation_velocity(self, model: ModelView, r: Array, v: Array, arm: Array) -> Array:
        """`w x arm` (c + s, 3) of the pieces' bodies, from three of their edges E: `E'(E^-1 arm)`."""
        corners = self.pieces.body_nodes(model, self.pieces.owners)
        edges = r[corners[:, 1:]] - r[corners[:, :1]]
        rates = v[corners[:, 1:]] - v[corners[:, :1]]
        own = jnp.linalg.solve(jnp.swapaxes(edges, -1, -2), arm[..., None])[..., 0]
        return jnp.sum(rates * own[..., None], axis=1)

    def force(self, k: Kinematics) -> Array:
        normal = self.normal(k)
        slip, back = jax.vjp(lambda v: self.slips(k.model, k.r, v), k.v)
        rub = (self.friction * normal / jnp.sqrt(dot(slip, slip) + CREEP_SPEED**2))[:, None] * slip
        return self._contact_force(k, normal) - back(rub)[0]
