"""The wave force of the thesis, with all its simplifications, for comparison."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.read import Values
from dropper_jax.effects.drag_velocity import drag_velocity
from dropper_jax.model import Effect, Kinematics
from dropper_jax.scene import SceneData
from dropper_jax.sea import Motion


@component
class ThesisWaveForce(Effect):
    """Force `L (pi/4 rho D^2 C_M u' + 1/2 rho D C_D |u_i| u_i)` per component i, thesis (C.22)-(C.24).

    u is the water's velocity at the origin for all nodes. The nodes' own velocity, buoyancy, the surface and the
    directions of the links are ignored, so the water does not damp the line. The printed force is per metre of
    cylinder; here it is multiplied by the link's length and has the absolute value that (6.12)-(6.13) lack (errata).
    `velocity = "relative"` uses (6.13) before that simplification: see `RelativeThesisWaveForce`.
    """

    name = "thesis_wave_force"
    single_line = True
    needs_water = True
    constant = True
    c_d: Array = parameter("drag coefficient", unit="-", low=0.0, default=2.0)
    c_m: Array = parameter("inertia coefficient", unit="-", low=0.0, default=1.0)
    c_a: Array = parameter("added mass coefficient, with relative velocity", unit="-", low=0.0, default=None)
    velocity: str = option(
        "velocity of the water: absolute, or relative to the node",
        choices=("absolute", "relative"),
        default="absolute",
    )

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        if values["c_a"] is not None and values["velocity"] == "absolute":
            raise SceneError("effects.thesis_wave_force.c_a: is only used with velocity 'relative'")

    @classmethod
    def build(cls, values: Values, scene: SceneData) -> Effect:
        if values["velocity"] == "absolute":
            return cls(**values)
        if values["c_a"] is None:  # without added mass every scheme supports it
            return RelativeThesisWaveForce(**values)
        return RelativeThesisWaveForceWithAddedMass(**values)

    def prepare(self, k: Kinematics) -> Motion:
        """The water at the origin."""
        return k.sea.at(jnp.zeros((1, 3), k.r.dtype), k.t)

    def force(self, k: Kinematics) -> Array:
        water = k.prepared(self)
        return self._force(k, water, water.velocity)

    def _force(self, k: Kinematics, water: Motion, velocity: Array) -> Array:
        """The force (nodes, 3) [N] of this velocity of the water in the drag [m/s]."""
        inertia = k.line.node_share(k.sea.density * k.line.volume * self.c_m)[:, None]
        return inertia * water.acceleration + self._drag(k) * jnp.abs(velocity) * velocity

    def _drag(self, k: Kinematics) -> Array:
        """Drag over the squared velocity of the water (nodes, 1) [kg/m]."""
        line = k.line
        return line.node_share(0.5 * k.sea.density * line.needed_diameter * line.length * self.c_d)[:, None]


@component
class RelativeThesisWaveForce(ThesisWaveForce):
    """The same with the nodes' own motion, thesis (6.13).

        L (pi/4 rho D^2 (C_M u' - C_A v') + 1/2 rho D C_D |w_i| w_i),    w = u - v

    w is the velocity of the water at the origin relative to the node. The absolute value and the split of
    `C_M (u' - v')` in (6.12)-(6.13) are corrected (errata).
    """

    constant = False

    def force(self, k: Kinematics) -> Array:
        water = k.prepared(self)
        decay = 2.0 * self._drag(k) * jnp.abs(water.velocity - (k.v if k.before is None else k.before))
        relative = water.velocity - drag_velocity(k, decay / k.model.node_mass[:, None])
        return self._force(k, water, relative)


@component
class RelativeThesisWaveForceWithAddedMass(RelativeThesisWaveForce):
    """The same with `-C_A v'` of (6.13), as added mass on the left."""

    def _added_mass(self, k: Kinematics) -> Array:
        return (k.line.node_share(k.sea.density * k.line.volume) * self.c_a)[:, None]

    def inertia(self, k: Kinematics, a: Array) -> Array:
        """Inertia force (nodes, 3) [N] of the added mass."""
        return self._added_mass(k) * a

    def kinetic(self, k: Kinematics) -> Array:
        """Kinetic energy of the added mass [J]."""
        return 0.5 * jnp.sum(self._added_mass(k) * k.v**2)
