"""Friction in the joints: viscous and dry, on the relative rate of neighbouring links and on the ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import jax
import jax.numpy as jnp

from dropper_jax.effects.base import Law
from dropper_jax.errors import SceneError
from dropper_jax.fields import component, parameter
from dropper_jax.kinematics import Kinematics, gather_links, safe_norm

if TYPE_CHECKING:
    from dropper_jax.model import Line

#: Part of a stuck joint's torque along its links, which moves nothing and would be undetermined otherwise.
SPIN_COMPLIANCE = 1e-9
#: A joint counts as still where stopping it within the step takes less than this share of the dry torque. A held joint
#: keeps a rate of rounding size; its sign, taken for a motion, let go of the joint in every few steps.
AT_REST = 1e-9


@component
class JointFriction(Law):
    """Torque `-c w - tau w/|w|` in each joint, w the relative angular velocity of its two links (the ground's is 0).

    Joint 0 is the first point's, joint n the last one's where it is held. Links do not spin about their axes. With
    `axis` the joints are pins: only the component along it counts. Torques act as couples of nodal forces, so that
    their power is exactly `torque . w`.

    Dry friction is set-valued: |torque| <= `dry`. Its unknown z is solved with the step, for
    `p_mid = z - 2 rho w_mid` and `p_end = z - rho w_end` (rho an inertia over the step, its value does not change
    the solutions):

    - slides where |p_mid| > tau:    z = tau p_mid/|p_mid|, against the mid-step rate;
    - else held unless that would push (p_end . w_0 > 0, then z = 0):    z = p_end, which is w_end = 0, or its
      projection on the ball of radius tau.

    A law on the mid-step rate alone would leave the rate ringing for ever (w_end = -w_0); one on the end rate alone
    lets the energy rise. Here `z . w_mid <= 0` in every case and a held joint creeps by nothing.
    """

    name: ClassVar[str] = "joint_friction"
    reach: ClassVar[int] = 2
    viscous: jax.Array | None = parameter(
        "viscous coefficient c", unit="N m s/rad", shape="joint", low=0.0, optional=True
    )
    dry: jax.Array | None = parameter("dry friction torque tau", unit="N m", shape="joint", low=0.0, optional=True)
    axis: jax.Array | None = parameter("direction of the pins", unit="-", shape="vector", optional=True)

    @classmethod
    def check(cls, values: Mapping[str, Any], scene: Any) -> None:
        if values["viscous"] is None and values["dry"] is None:
            raise SceneError("effects.joint_friction: give `viscous`, `dry` or both; both are missing")
        axis = values["axis"]
        if axis is not None and not sum(x * x for x in axis) > 0:
            raise SceneError(f"effects.joint_friction.axis: {list(axis)} has no direction; give a non-zero 3-vector")

    @property
    def components(self) -> int:
        if self.dry is None:
            return 0
        return 3 if self.axis is None else 1

    def _pin(self) -> jax.Array:
        return self.axis / safe_norm(self.axis)

    def relative_rates(self, k: Kinematics) -> jax.Array:
        """Relative rates of the joints, (joints, 3), or (joints, 1) about the pins [rad/s]."""
        rates = k.angular_rates
        zero = jnp.zeros_like(rates[:1])
        ahead = jnp.concatenate([rates, zero]) if k.model.end_held else rates
        behind = jnp.concatenate([zero, rates]) if k.model.end_held else jnp.concatenate([zero, rates[:-1]])
        relative = ahead - behind
        return relative if self.axis is None else (relative @ self._pin())[:, None]

    def torque_force(self, k: Kinematics, torque: jax.Array) -> jax.Array:
        """Nodal forces (nodes, 3) [N] of joint torques (joints, c) [N m]."""
        if self.axis is not None:
            torque = torque * self._pin()
        after = torque[1:] if k.model.end_held else jnp.concatenate([torque[1:], jnp.zeros_like(torque[:1])])
        before = torque[:-1] if k.model.end_held else torque
        couple = jnp.cross(before - after, k.tangents) / safe_norm(k.links)[:, None]
        return -gather_links(couple, k.model.end_held)

    def _per_joint(self, value: jax.Array, joints: int) -> jax.Array:
        return jnp.broadcast_to(value, (joints,)) if value.ndim == 0 else value[:joints]

    def force(self, k: Kinematics) -> jax.Array | None:
        if self.viscous is None:
            return jnp.zeros_like(k.r)
        rates = self.relative_rates(k)
        return self.torque_force(k, -self._per_joint(self.viscous, len(rates))[:, None] * rates)

    def law_force(self, k: Kinematics, z: jax.Array) -> jax.Array:
        return self.torque_force(k, z)

    def law_residual(self, mid: Kinematics, v0: jax.Array, v1: jax.Array, z: jax.Array, h: jax.Array) -> jax.Array:
        limit = self._per_joint(self.dry, len(z))[:, None]
        rate = self.relative_rates(mid)
        rate0 = self.relative_rates(mid.with_velocity(v0))
        rho = jnp.min(mid.line.mass * mid.line.length**2) / h
        p_mid = z - 2 * rho * rate
        p_end = z - rho * (2 * rate - rate0)
        size_mid, size_end = safe_norm(p_mid)[:, None], safe_norm(p_end)[:, None]
        slide = z - limit * p_mid / size_mid
        moving = rho * safe_norm(rate0)[:, None] > AT_REST * limit  # else its direction is rounding
        pushes = moving & (jnp.sum(p_end * rate0, axis=-1, keepdims=True) > 0)
        held = z - p_end + self._spin(mid, z)
        clipped = z - limit * p_end / size_end
        stuck = jnp.where(size_end <= limit, held, clipped)
        return jnp.where((size_mid > limit) | (limit <= 0), slide, jnp.where(pushes, z, stuck))

    def _spin(self, k: Kinematics, z: jax.Array) -> jax.Array:
        if self.axis is not None:
            return jnp.zeros_like(z)
        q = k.tangents
        ahead = jnp.concatenate([q, q[-1:]]) if k.model.end_held else q
        behind = jnp.concatenate([q[:1], q]) if k.model.end_held else jnp.concatenate([q[:1], q[:-1]])
        along = ahead + behind
        along = along / safe_norm(along)[:, None]
        return SPIN_COMPLIANCE * jnp.sum(z * along, axis=-1, keepdims=True) * along

    def law_scale(self, line: Line, h: jax.Array) -> jax.Array:
        """The torque of a link's weight [N m]."""
        return jnp.mean(line.mass * line.length) * 9.81
