"""Drag of water on the links (Morison), split across and along them."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from dropper_jax.effects.base import Effect
from dropper_jax.effects.wetting import parts, split, wetted
from dropper_jax.fields import component, option, parameter
from dropper_jax.kinematics import Kinematics, safe_norm


@component
class MorisonDrag(Effect):
    """Drag `F = 1/2 rho L w (Cdn D |u_n| u_n + Cdt pi D |u_t| u_t)` of the water's velocity u relative to the node.

    Axial drag works on the wetted skin, pi D, as in MoorDyn (thesis (6.12) lacks the absolute value, (C.22)-(C.24)
    the relative velocity: errata). w is the wet fraction. The links' directions are those of the predicted middle of
    the step, which is second order and keeps the force on its own node; `tangents = "implicit"` solves for them too.
    Either way the force opposes the relative velocity: in water at rest it never adds energy.
    """

    name: ClassVar[str] = "morison_drag"
    needs_water: ClassVar[bool] = True
    cdn: jax.Array = parameter("drag coefficient across the link", unit="-", shape="link", low=0.0)
    cdt: jax.Array = parameter("drag coefficient along the link", unit="-", shape="link", low=0.0, default=0.0)
    tangents: str = option("directions of the links", choices=("frozen", "implicit"), default="frozen")

    @property
    def reach(self) -> int:
        return 0 if self.tangents == "frozen" else 1

    def force(self, k: Kinematics) -> jax.Array:
        water, line = k.water, k.line
        tangents = water.tangents if self.tangents == "frozen" else k.tangents
        skin = 0.5 * k.model.sea.density * line.diameter * line.length
        relative = water.motion.velocity - k.v
        total = jnp.zeros_like(k.v)
        for part in parts(k):
            across, along = split(part.at(relative), part.take(tangents))
            wet = part.share * wetted(k, part, tangents, water.motion.elevation)
            normal = (wet * part.take(skin * self.cdn) * safe_norm(across))[:, None] * across
            axial = (wet * part.take(jnp.pi * skin * self.cdt) * safe_norm(along))[:, None] * along
            total = total + part.collect(normal + axial)
        return total
