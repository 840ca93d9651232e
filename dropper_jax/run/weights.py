"""Weights of links in water."""

from __future__ import annotations

import numpy as np

from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.scene import SceneData

#: Gravity [m/s^2] of scenes without a sea.
GRAVITY = 9.81


def wet_weights(scene: SceneData) -> np.ndarray:
    """Weight less buoyancy (n,) [N] of each link under water, by the effects that the scene has."""
    line, weight = scene.line, scene.effects.get("weight")
    if weight is None:
        return np.zeros(line.links)
    if weight.get("wet_weight") is not None:
        return np.broadcast_to(np.asarray(weight["wet_weight"], float), (line.links,))
    found = line.mass * (GRAVITY if weight.get("gravity") is None else float(weight["gravity"]))
    diameter = displaced_diameter(line, scene)
    if "buoyancy" in scene.effects and diameter is not None:
        found = found - scene.sea.density * scene.sea.gravity * 0.25 * np.pi * diameter**2 * line.length
    return found
