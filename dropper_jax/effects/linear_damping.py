"""Linear damping of the nodes."""

from __future__ import annotations

from jax import Array

from dropper_jax.base.fields import component, parameter
from dropper_jax.effects.drag_velocity import still_drag_velocity
from dropper_jax.model import Effect, Kinematics, per_node


@component
class LinearDamping(Effect):
    """Linear damping `F = -b_l v` on each node (thesis (4.13), first term)."""

    name = "linear_damping"
    b_l: Array = parameter("linear damping coefficient", unit="kg/s", shape="node", low=0.0)

    def force(self, k: Kinematics) -> Array:
        b_l = per_node(self.b_l, k.free)
        return -b_l * still_drag_velocity(k, b_l / k.model.node_mass[:, None])
