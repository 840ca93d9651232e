"""Water surface and seabed of a scene at given positions, for reports and figures after a run."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.effects import EFFECTS
from dropper_jax.load.checks_water import line_reach
from dropper_jax.scene import SceneData
from dropper_jax.sea.make import make_sea


def surface_over(scene: SceneData, positions: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Elevation (k, m) [m] of the surface over positions (k, m, 3) [m] at times (k,) [s]; zero without waves."""
    if scene.sea is None or scene.sea.waves is None:
        return np.zeros(positions.shape[:2])
    sea = make_sea(scene.sea, line_reach(scene))
    # one instant after another: a sea of hundreds of components over all nodes and times at once would exceed the
    # memory
    find = jax.jit(lambda r, t: jax.lax.map(lambda one: sea.elevation(*one), (r, t)))
    return np.asarray(find(jnp.asarray(positions), jnp.asarray(times)))


def bed_height(scene: SceneData, positions: np.ndarray) -> np.ndarray | None:
    """Height z [m] of the seabed, as given, at positions (..., 3) [m]; None for a scene without [effects.seabed]."""
    if "seabed" not in scene.effects:
        return None
    values = scene.effects["seabed"]
    if values["bed_x"] is None:
        depth = values["depth"] if values["depth"] is not None else scene.sea.depth
        return np.full(positions.shape[:-1], -float(depth))
    bed = EFFECTS["seabed"].build(values, scene)
    return np.asarray(bed.bed_height(positions.reshape(-1, 3), rounded=0.0)).reshape(positions.shape[:-1])
