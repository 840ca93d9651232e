"""Quadratic damping of the nodes."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import safe_norm
from dropper_jax.effects.drag_velocity import still_drag_velocity
from dropper_jax.model import Effect, Kinematics, per_node


@component
class QuadraticDamping(Effect):
    """Quadratic damping `F = -b_q |v| v` on each node.

    The thesis prints `v^2` per component ((4.13)-(4.14)), which adds energy for negative velocities (erratum).
    `form = "componentwise"` is the corrected form `-b_q |v_i| v_i`, for reproduction; it depends on the axes.
    """

    name = "quadratic_damping"
    b_q: Array = parameter("quadratic damping coefficient", unit="kg/m", shape="node", low=0.0)
    form: str = option(
        "isotropic |v| v, or |v_i| v_i per component",
        choices=("isotropic", "componentwise"),
        default="isotropic",
    )

    def force(self, k: Kinematics) -> Array:
        b_q = per_node(self.b_q, k.free)
        v = k.v
        if k.before is not None:
            v = still_drag_velocity(k, 2.0 * b_q * self._speed(k.before) / k.model.node_mass[:, None])
            if self.form == "componentwise":  # each direction is damped separately
                v = jnp.where(v * k.v < 0.0, 0.0, v)
        return -b_q * self._speed(v) * v

    def _speed(self, v: Array) -> Array:
        if self.form == "componentwise":
            return jnp.abs(v)
        return safe_norm(v)[:, None]
