"""Buoyancy of the displaced water, up to the surface."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, parameter
from dropper_jax.base.numerics import upright
from dropper_jax.base.read import Plain, Values
from dropper_jax.effects.submerged import wet_share
from dropper_jax.model import Effect, Kinematics, ModelView
from dropper_jax.scene import LineSpec, SceneData


@component
class Buoyancy(Effect):
    """Buoyancy `F = rho g V w z`, V the volume of the part of each link at the node and w its
    submerged fraction (`wet_share`).

    Hydrostatics up to the actual surface. The dynamic pressure of waves is in the `rho V u'` of `morison_inertia` and
    is not added again. The volume is `pi/4 D^2 L` with the line's `diameter` D, or follows from `wet_weight` as
    `(m g - wet_weight)/(rho g)`. If both are given they must agree. `effects.weight` is then the weight in air.
    """

    name = "buoyancy"
    needs_water = True
    wet_weight: Array | None = parameter(
        "weight in water per link, from which the volume follows", unit="N", shape="link", default=None
    )

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        if scene.effects.get("weight", {}).get("wet_weight") is not None:
            raise SceneError(
                "effects.weight.wet_weight: is a weight in water, but effects.buoyancy subtracts the buoyancy again; "
                "allowed: one of the two, or effects.buoyancy.wet_weight"
            )
        check_volume(scene, values["wet_weight"])

    def per_link(self, model: ModelView) -> Array:
        """Buoyancy of each link under water (n,) [N]."""
        return model.needed_sea.density * model.needed_sea.gravity * model.line.volume

    def force(self, k: Kinematics) -> Array:
        water = k.water
        lift = self.per_link(k.model)
        up = jnp.zeros_like(k.r[:, 2])
        for end in k.line.link_ends():
            wet = wet_share(k, end, water.tangents, water.motion.elevation)
            up = up + end.collect(end.share * lift * wet)
        return upright(up)


def _volume_from_weight(scene: SceneData, wet_weight: Plain) -> np.ndarray:
    """`(m g - wet)/(rho g)` of each link [m^3]."""
    sea = scene.needed_sea
    dry = scene.line.mass * scene.gravity
    wet = np.broadcast_to(wet_weight, dry.shape)
    worst = np.argmin(dry - wet)
    if dry[worst] <= wet[worst]:
        raise SceneError(
            f"effects.buoyancy.wet_weight: {wet[worst]:g} N of link {worst + 1} is not below its dry weight; "
            f"allowed: < {dry[worst]:g} N"
        )
    return (dry - wet) / (sea.density * sea.gravity)


#: Relative difference between two given volumes that is still attributed to rounding of printed values.
SAME_VOLUME = 1e-3


def check_volume(scene: SceneData, wet_weight: Plain) -> None:
    """Reject lines without a volume: it needs the diameter, dry and wet weight, or both if they agree.

    Raises:
        SceneError: neither is given, or they differ.
    """
    line = scene.line
    if wet_weight is None:
        if line.diameter is None:
            raise SceneError("line.0.diameter: missing; effects.buoyancy needs it, or its own `wet_weight` [N]")
        return
    volume = _volume_from_weight(scene, wet_weight)
    if line.diameter is None:
        return
    geometric = 0.25 * np.pi * line.diameter**2 * line.length
    error = np.abs(geometric / volume - 1.0)
    worst = np.argmax(error)
    if error[worst] > SAME_VOLUME:
        matching = np.sqrt(4.0 * volume[worst] / (np.pi * line.length[worst]))
        raise SceneError(
            f"line.0.diameter: {line.diameter[worst]:g} m of link {worst + 1} displaces {geometric[worst]:.4g} m^3, "
            f"but dry and wet weight leave {volume[worst]:.4g} m^3; allowed: one of the two, or {matching:.5g} m"
        )


def displaced_diameter(line: LineSpec, scene: SceneData) -> np.ndarray | None:
    """Diameters of the links [m]: as given, or of cylinders with the volume that follows from dry and wet weight."""
    wet_weight = scene.effects.get("buoyancy", {}).get("wet_weight")
    if line.diameter is not None or wet_weight is None or scene.sea is None:
        return line.diameter
    return np.sqrt(4.0 * _volume_from_weight(scene, wet_weight) / (np.pi * line.length))


def drag_diameter(scene: SceneData) -> np.ndarray:
    """Diameters of all links for drag and added mass [m]: the outer ones, or those of the displaced volume.

    Raises:
        SceneError: a line has none.
    """
    line = scene.line
    if line.outer_diameter is not None:
        return line.outer_diameter
    diameter = displaced_diameter(line, scene)
    if diameter is None:
        raise SceneError("line.diameter: missing; drag and added mass need the diameter of every line [m]")
    return diameter
