"""The water surface and the seabed of a scene over given positions, and the region that its lines reach."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import jax
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from dropper_jax.backend.programs import cached_jit
from dropper_jax.effects.seabed import Seabed
from dropper_jax.scene import SceneData
from dropper_jax.sea import Sea
from dropper_jax.sea.make import make_sea


def line_reach(scene: SceneData) -> tuple[np.ndarray, float]:
    """A ball that the line cannot leave while its points are fixed: its centre (3,) [m] and radius [m]."""
    line = scene.single_line
    if line is None:
        positions = np.array([item.position for item in (*scene.points, *scene.bodies, *scene.vessels)])
        middle = np.mean(positions, axis=0)
        longest = max(line.total for line in scene.lines)
        return middle, (np.max(np.linalg.norm(positions - middle, axis=1)) + longest)
    if scene.point(line.end).is_free:
        return scene.point(line.start).position, line.total
    return middle_of_line(scene, 0), 0.5 * line.total


def middle_of_line(scene: SceneData, index: int) -> np.ndarray:
    """The middle (3,) between the ends of a line [m]."""
    line = scene.lines[index]
    return 0.5 * (scene.point(line.start).position + scene.point(line.end).position)


def bed_height(scene: SceneData, positions: np.ndarray) -> np.ndarray | None:
    """Height z [m] of the seabed, as given, at positions (..., 3) [m]; None for a scene without [effects.seabed]."""
    if "seabed" not in scene.effects:
        return None
    values = scene.effects["seabed"]
    if values["bed_x"] is None:
        depth = values["depth"]
        if depth is None:
            depth = scene.needed_sea.depth
        return np.full(positions.shape[:-1], -float(depth))
    height = Seabed.build(values, scene).bed_height(positions.reshape(-1, 3), rounded=0.0)
    return np.asarray(height).reshape(positions.shape[:-1])


@dataclass(frozen=True)
class Surface:
    """The surface of a scene's water: that of its level and of its waves, or of the level alone."""

    scene: SceneData
    waves: bool = True

    @cached_property
    def _sea(self) -> Sea | None:
        """The water; None where its surface is at z = 0."""
        spec = self.scene.sea
        if spec is None or (spec.level is None and (spec.waves is None or not self.waves)):
            return None
        if not self.waves:
            spec = replace(spec, waves=None)
        return make_sea(spec, line_reach(self.scene))

    @cached_property
    def lowest(self) -> float:
        """A height [m] to which the surface never falls."""
        spec = self.scene.sea
        if spec is None:
            return 0.0
        level = 0.0
        if spec.level is not None:
            level = spec.level.lowest
        if spec.waves is None or not self.waves:
            return level
        # troughs stay above -hs, those of components above the sum of amplitudes; twice, for an opposing current
        size = spec.waves.hs
        if size is None:
            size = np.sum(np.abs(spec.waves.size))
        return level - 2.0 * float(size)

    def over(self, positions: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Height (k, m) [m] over positions (k, m, 3) [m] at times (k,) [s]."""
        if self._sea is None:
            return np.zeros(positions.shape[:2])
        return np.asarray(_elevations(self._sea, positions, times))


@cached_jit()
def _elevations(sea: Sea, positions: ArrayLike, times: ArrayLike) -> Array:
    # one instant after another: a sea of hundreds of components over all nodes and times at once would exceed the
    # memory
    return jax.lax.map(lambda one: sea.elevation(*one), (positions, times))


def surface_over(scene: SceneData, positions: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Height (k, m) [m] of the surface over positions (k, m, 3) [m] at times (k,) [s], that of level and waves."""
    return Surface(scene).over(positions, times)
