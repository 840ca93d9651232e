"""Friction in the joints: viscous and dry, on the relative rate of neighbouring links and on the ends."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, parameter
from dropper_jax.base.numerics import cross, safe_norm
from dropper_jax.base.read import Values
from dropper_jax.model import Kinematics, Law, Line
from dropper_jax.scene import SceneData

#: Added under roots [(N m)^2, (rad/s)^2]: keeps derivatives finite at zero, also in float32.
ROOT_FLOOR = 1e-30


@component
class JointFriction(Law):
    """Torque `-c w - tau w/|w|` in each joint, w the relative angular velocity of its two links (the ground's is 0).

    Joint 0 is at the first point, joint n at the last one if it is fixed. Links do not spin about their axes. With
    `axis` the joints are pins: only the component along it counts. Torques act as couples of nodal forces, so that
    their power is exactly `torque . w`.

    Dry friction is set-valued: |torque| <= `dry`. Its unknown z is the projection of `z - 2 rho w_mid` on the ball of
    radius tau. The joint slides with `z = -tau w_mid/|w_mid|` or sticks with `w_mid = 0` (rho is an inertia over the
    step; its value does not change the solutions). The law is monotone, so every step has a solution and
    `z . w_mid <= 0`. Sticking joints may still have a rate at the end of the step; `holding` marks the joints that
    are then stopped.
    """

    name = "joint_friction"
    single_line = True
    reach = 2  # a torque acts on the nodes of both neighbouring links
    viscous: Array | None = parameter("viscous coefficient c", unit="N m s/rad", shape="joint", low=0.0, default=None)
    dry: Array | None = parameter("dry friction torque tau", unit="N m", shape="joint", low=0.0, default=None)
    axis: Array | None = parameter("direction of the pins", unit="-", shape="vector", default=None)

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        if values["viscous"] is None and values["dry"] is None:
            raise SceneError("effects.joint_friction: give `viscous`, `dry` or both; both are missing")
        if scene.failures:
            raise SceneError(
                "effects.joint_friction: would pass torques through links that [[failure]] breaks; allowed: one of the "
                "two"
            )
        axis = values["axis"]
        if axis is not None and not np.any(axis):
            raise SceneError(f"effects.joint_friction.axis: {list(axis)} has no direction; give a non-zero 3-vector")

    @property
    def components(self) -> int:
        if self.dry is None:
            return 0
        if self.axis is None:
            return 3
        return 1

    def _pin_direction(self) -> Array:
        return self.axis / safe_norm(self.axis)

    def relative_rates(self, k: Kinematics) -> Array:
        """Relative rates of the joints, (joints, 3), or (joints, 1) about the pins [rad/s]."""
        rates = k.angular_rates
        zero = jnp.zeros_like(rates[:1])
        joints = k.model.geometry.links + k.model.geometry.ends - 1
        relative = jnp.concatenate([rates, zero])[:joints] - jnp.concatenate([zero, rates])[:joints]
        if self.axis is None:
            return relative
        return (relative @ self._pin_direction())[:, None]

    def torque_force(self, k: Kinematics, torque: Array) -> Array:
        """Nodal forces (nodes, 3) [N] of joint torques (joints, c) [N m]."""
        if self.axis is not None:
            torque = torque * self._pin_direction()
        links = k.model.geometry.links
        after = jnp.concatenate([torque[1:], jnp.zeros_like(torque[:1])])[:links]
        return -k.model.geometry.gather(cross(torque[:links] - after, k.tangents) / safe_norm(k.links)[:, None])

    def force(self, k: Kinematics) -> Array:
        if self.viscous is None:
            return jnp.zeros_like(k.r)
        rates = self.relative_rates(k)
        return self.torque_force(k, -_per_joint(self.viscous, len(rates)) * rates)

    def law_force(self, k: Kinematics, z: Array) -> Array:
        return self.torque_force(k, z)

    def law_residual(self, k: Kinematics, z: Array, h: Array, easing: Array | None = None) -> Array:
        limit = self._limit(z)
        rate = self.relative_rates(k)
        rho = self._rho(k, h)
        exact = z - _project(z - 2 * rho * rate, limit)
        if easing is None:
            return exact
        # smoothed: |w| becomes sqrt(w^2 + width^2), so that z = -tau w/|w| has a slope at w = 0
        width = easing * limit / rho
        speed = jnp.sqrt(jnp.sum(rate**2, axis=-1, keepdims=True) + width**2 + ROOT_FLOOR)
        weight = jax.lax.stop_gradient(rho / (limit + rho * speed))  # scales the row to that of the exact law
        return jnp.where(easing > 0, weight * (speed * z + limit * rate), exact)

    def admissible(self, z: Array) -> Array:
        return _project(z, self._limit(z))

    def rates(self, k: Kinematics) -> Array:
        return self.relative_rates(k)

    def sliding_power(self, k: Kinematics) -> Array:
        if self.dry is None:
            return jnp.zeros(())
        rates = self.relative_rates(k)
        return jnp.sum(_per_joint(self.dry, len(rates)) * row_sizes(rates))

    def holding(self, k: Kinematics, z: Array, h: Array) -> Array:
        return row_sizes(z - 2 * self._rho(k, h) * self.relative_rates(k)) < self._limit(z)

    def _limit(self, z: Array) -> Array:
        """tau of each joint (joints, 1) [N m]."""
        return _per_joint(jnp.asarray(self.dry), len(z))

    def _rho(self, k: Kinematics, h: Array) -> Array:
        """rho, an inertia over the step [kg m^2/s]: that of the lightest link."""
        return jnp.min(k.line.mass * k.line.length**2) / h

    def law_scale(self, line: Line, h: Array) -> Array:
        """The torque of a link's weight [N m]."""
        return jnp.mean(line.mass * line.length) * GRAVITY


def _per_joint(value: Array, joints: int) -> Array:
    """One number for all joints, or one for each, as a column (joints, 1)."""
    if value.ndim == 0:
        return jnp.broadcast_to(value, (joints, 1))
    return value[:joints, None]


def _project(z: Array, limit: Array) -> Array:
    """The nearest torques with |z| <= limit."""
    size = row_sizes(z)
    return jnp.where(size > limit, limit / size * z, z)


def row_sizes(z: Array) -> Array:
    """|z| of each row as a column, with a finite derivative at zero."""
    return jnp.sqrt(jnp.sum(z**2, axis=-1, keepdims=True) + ROOT_FLOOR)
