"""The wave force of the thesis, with all its simplifications, to compare with."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from dropper_jax.base.fields import component, parameter
from dropper_jax.model import Effect, Kinematics
from dropper_jax.sea import Motion


@component
class ThesisWaveForce(Effect):
    """Force `L (pi/4 rho D^2 C_M u' + 1/2 rho D C_D |u_i| u_i)` per component i, thesis (C.22)-(C.24).

    u is the water's velocity at the origin for all nodes; the nodes' own velocity, buoyancy, the surface and the
    directions of the links do not come in, so that the water does not damp the line. The printed force is per metre of
    cylinder and is multiplied by the link's length here, with the absolute value that (6.12)-(6.13) lack (errata).
    """

    name: ClassVar[str] = "thesis_wave_force"
    single_line: ClassVar[bool] = True
    needs_water: ClassVar[bool] = True
    constant: ClassVar[bool] = True
    c_d: jax.Array = parameter("drag coefficient", unit="-", low=0.0, default=2.0)
    c_m: jax.Array = parameter("inertia coefficient", unit="-", low=0.0, default=1.0)

    def prepare(self, k: Kinematics) -> Motion:
        """The water at the origin."""
        return k.model.sea.at(jnp.zeros((1, 3), k.r.dtype), k.t)

    def force(self, k: Kinematics) -> jax.Array:
        line, density = k.line, k.model.sea.density
        water = k.prepared(self)
        u, change = water.velocity[0], water.acceleration[0]
        inertia = line.node_share(density * line.volume * self.c_m)
        drag = line.node_share(0.5 * density * line.diameter * line.length * self.c_d)
        return inertia[:, None] * change + drag[:, None] * (jnp.abs(u) * u)
