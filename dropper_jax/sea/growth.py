"""Mussels on a rope: thickness and density over depth give mass, diameter and wet weight of each link."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dropper_jax.errors import SceneError
from dropper_jax.fields import parameter
from dropper_jax.schema import plain, read_fields, refuse

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


@dataclasses.dataclass(frozen=True, eq=False)
class GrowthSpec:
    """`[line.growth]`: a layer of mussels on the line, whose own mass and diameter are those of the bare rope.

    Linear between the given depths, held outside them.
    """

    depth: np.ndarray = parameter("depths below the mean surface, rising", unit="m", shape="table")
    thickness: np.ndarray = parameter("thickness of the layer at those depths", unit="m", shape="table", low=0.0)
    density: np.ndarray = parameter(
        "density of the layer, one or one per depth", unit="kg/m^3", shape="numbers", low=0.0
    )

    @classmethod
    def read(cls, table: Any, path: str) -> GrowthSpec:
        spec = cls(**read_fields(cls, table, path, {}))
        depths = len(spec.depth)
        if not depths or np.any(np.diff(spec.depth) <= 0):
            raise refuse(f"{path}.depth", plain(spec.depth), "does not rise", "one or more rising depths [m]")
        if len(spec.thickness) != depths:
            raise refuse(f"{path}.thickness", plain(spec.thickness), f"has {len(spec.thickness)} entries", str(depths))
        if np.ndim(spec.density) and len(spec.density) not in (1, depths):
            raise refuse(f"{path}.density", plain(spec.density), f"has {len(spec.density)} entries", f"1 or {depths}")
        return spec

    def table(self) -> dict[str, Any]:
        """Plain values from which `read` makes the same."""
        return {f.name: plain(getattr(self, f.name)) for f in dataclasses.fields(self)}

    def over(self, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Thickness [m] and density [kg/m^3] at depths [m]."""
        density = np.broadcast_to(self.density, self.depth.shape)
        return np.interp(depth, self.depth, self.thickness), np.interp(depth, self.depth, density)


def with_growth(
    scene: Scene, depth: Sequence[float], thickness: Sequence[float], density: Sequence[float] | float
) -> Scene:
    """The scene with mussels on its bare line, thickness [m] and density [kg/m^3] given over depth [m] (rising).

    The depth of a link is that of its middle in the pose of the bare line at rest in calm water. Changes `line.0.mass`
    and `line.0.diameter`; `[line.growth]` does the same and keeps the bare rope in the scene.

    Raises:
        SceneError: no sea, no diameter of the bare rope, or tables that do not fit together.
    """
    table = scene.to_dict()
    table["line"][0]["growth"] = {"depth": plain(depth), "thickness": plain(thickness), "density": plain(density)}
    return overgrown(type(scene).from_dict(table))


def overgrown(scene: Scene) -> Scene:
    """The scene with its `[line.growth]` in mass and diameter of the links; a scene without growth as it is."""
    from dropper_jax.simulate import equilibrium
    from dropper_jax.solution import line_slices

    if all(line.growth is None for line in scene.lines):
        return scene
    table = scene.to_dict()
    for line in table["line"]:
        line.pop("growth", None)
    bare = type(scene).from_dict(table)
    z = equilibrium(bare).positions[:, 2]
    changes = {}
    for i, (line, where) in enumerate(zip(scene.lines, line_slices(scene), strict=True)):
        if line.growth is None:
            continue
        nodes = z[where.nodes]
        layer, heavy = line.growth.over(-0.5 * (nodes[1:] + nodes[:-1]))
        found = grown(line.length, line.mass, line.diameter, layer, heavy, scene.sea.density, scene.sea.gravity)
        changes |= {f"line.{i}.mass": found.mass, f"line.{i}.diameter": found.diameter}
    return bare.with_values(changes)


def check_growth(scene: Scene) -> None:
    """Growth needs water and the diameter of the bare rope, and the volume must follow from the diameter."""
    for i, line in enumerate(scene.lines):
        if line.growth is None:
            continue
        path = f"line.{i}"
        if scene.sea is None:
            raise SceneError(f"{path}.growth: needs water, but the scene has no [sea]; allowed: [sea] with `depth`")
        if line.diameter is None:
            raise SceneError(f"{path}.diameter: missing; {path}.growth needs that of the bare rope, > 0 m")
        if line.centre_of_mass is not None:
            raise SceneError(
                f"{path}.growth: is for point masses at the nodes, but the line has compound links; leave it out"
            )
        if scene.effects.get("buoyancy", {}).get("wet_weight") is not None:
            raise SceneError(
                f"effects.buoyancy.wet_weight: is that of the bare line, but {path}.growth changes it; leave it out"
            )
