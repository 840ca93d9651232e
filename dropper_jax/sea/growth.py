"""Mussels on a rope: thickness and density over depth give mass, diameter and wet weight of each link."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dropper_jax.errors import SceneError

if TYPE_CHECKING:
    from dropper_jax.scene import Scene


class Grown(NamedTuple):
    """Per link (n,): mass [kg], diameter [m], weight in water [N]."""

    mass: np.ndarray
    diameter: np.ndarray
    wet_weight: np.ndarray


def grown(
    length: np.ndarray,
    bare_mass: np.ndarray,
    bare_diameter: np.ndarray,
    thickness: np.ndarray,
    density: np.ndarray,
    water: float = 1025.0,
    gravity: float = 9.81,
) -> Grown:
    """A layer of `thickness` [m] and `density` [kg/m^3] on links of the bare rope, all (n,).

    `D = D0 + 2 t`, `m = m0 + density pi/4 (D^2 - D0^2) L`, wet weight `g (m - rho pi/4 D^2 L)`. The density is that of
    the layer as it displaces water: mussels, with what is between them left out of the diameter.
    """
    diameter = bare_diameter + 2.0 * thickness
    area = 0.25 * np.pi * (diameter**2 - bare_diameter**2)
    mass = bare_mass + density * area * length
    return Grown(mass, diameter, gravity * (mass - water * 0.25 * np.pi * diameter**2 * length))


def with_growth(
    scene: Scene, depth: Sequence[float], thickness: Sequence[float], density: Sequence[float] | float
) -> Scene:
    """The scene with mussels on its bare line, thickness [m] and density [kg/m^3] given over depth [m] (rising).

    The depth of a link is that of its middle in the pose of the bare line at rest in calm water. Changes `line.0.mass`
    and `line.0.diameter`; linear between the given depths, held outside them.

    Raises:
        SceneError: no sea, no diameter of the bare rope, or tables that do not fit together.
    """
    from dropper_jax.simulate import equilibrium

    line = scene.lines[0]
    if scene.sea is None or line.diameter is None:
        raise SceneError("line.0.diameter: growth needs the diameter of the bare rope and a [sea]; allowed: both")
    depth, thickness = np.asarray(depth, float), np.asarray(thickness, float)
    density = np.broadcast_to(np.asarray(density, float), depth.shape)
    if depth.ndim != 1 or depth.shape != thickness.shape or np.any(np.diff(depth) <= 0) or np.any(thickness < 0):
        raise SceneError("growth.depth: needs rising depths and as many thicknesses, each >= 0 m")
    z = equilibrium(scene).positions[:, 2]
    middle = -0.5 * (z[1:] + z[:-1])
    layer, heavy = np.interp(middle, depth, thickness), np.interp(middle, depth, density)
    found = grown(line.length, line.mass, line.diameter, layer, heavy, scene.sea.density, scene.sea.gravity)
    return scene.with_values({"line.0.mass": found.mass, "line.0.diameter": found.diameter})
