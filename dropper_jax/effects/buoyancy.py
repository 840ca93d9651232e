"""Buoyancy of the displaced water, up to the surface."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from dropper_jax.effects.base import Effect
from dropper_jax.effects.wetting import parts, wetted
from dropper_jax.errors import SceneError
from dropper_jax.fields import component, parameter
from dropper_jax.kinematics import Kinematics
from dropper_jax.sea.checks import check_volume


@component
class Buoyancy(Effect):
    """Buoyancy `F = rho g V w z`, V the volume of the node's part and w its wet fraction (`effects.wetting`).

    Hydrostatics to the actual surface; the dynamic pressure of waves is in the `rho V u'` of `morison_inertia` and not
    added again. The volume is `pi/4 D^2 L`, D the line's `diameter`, or follows from `wet_weight` as
    `(m g - wet_weight)/(rho g)`; where both are given they must agree. `effects.weight` then is the weight in air.
    """

    name: ClassVar[str] = "buoyancy"
    needs_water: ClassVar[bool] = True
    wet_weight: jax.Array | None = parameter(
        "weight in water per link, from which the volume follows", unit="N", shape="link", optional=True
    )

    @classmethod
    def check(cls, values: Mapping[str, Any], scene: Any) -> None:
        if scene.effects.get("weight", {}).get("wet_weight") is not None:
            raise SceneError(
                "effects.weight.wet_weight: is a weight in water, but effects.buoyancy takes the buoyancy off again; "
                "allowed: one of the two, or effects.buoyancy.wet_weight"
            )
        check_volume(scene, values["wet_weight"])

    def force(self, k: Kinematics) -> jax.Array:
        sea, water = k.model.sea, k.water
        lift = sea.density * sea.gravity * k.line.volume
        up = jnp.zeros_like(k.r[:, 2])
        for part in parts(k):
            wet = wetted(k, part, water.tangents, water.motion.elevation)
            up = up + part.collect(part.share * part.take(lift) * wet)
        return jnp.zeros_like(k.r).at[:, 2].set(up)
