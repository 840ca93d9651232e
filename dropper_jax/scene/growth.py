"""`[line.growth]` of a scene: mussels on a rope."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.fields import parameter
from dropper_jax.base.read import Plain, plain, read_fields, refuse


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
    water: float = SEA_WATER,
    gravity: float = GRAVITY,
) -> Grown:
    """A layer of `thickness` [m] and `density` [kg/m^3] on links of the bare rope, all (n,).

    `D = D0 + 2 t`, `m = m0 + density pi/4 (D^2 - D0^2) L`, wet weight `g (m - rho pi/4 D^2 L)`. The density is that of
    the layer as it displaces water: mussels only, with the gaps between them excluded from the diameter.
    """
    diameter = bare_diameter + 2.0 * thickness
    area = 0.25 * np.pi * (diameter**2 - bare_diameter**2)
    mass = bare_mass + density * area * length
    return Grown(mass, diameter, gravity * (mass - water * 0.25 * np.pi * diameter**2 * length))


@dataclasses.dataclass(frozen=True, eq=False)
class GrowthSpec:
    """`[line.growth]`: a layer of mussels on the line, whose own mass and diameter are those of the bare rope.

    Linear between the given depths, constant outside them.
    """

    depth: np.ndarray = parameter("depths below the mean surface, rising", unit="m", shape="table")
    thickness: np.ndarray = parameter("thickness of the layer at those depths", unit="m", shape="table", low=0.0)
    density: np.ndarray = parameter(
        "density of the layer, one or one per depth", unit="kg/m^3", shape="numbers", low=0.0
    )

    @classmethod
    def read(cls, table: Plain, path: str) -> GrowthSpec:
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
        """Plain values from which `read` recreates the section."""
        return {f.name: plain(getattr(self, f.name)) for f in dataclasses.fields(self)}

    def over(self, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Thickness [m] and density [kg/m^3] at depths [m]."""
        density = np.broadcast_to(self.density, self.depth.shape)
        return np.interp(depth, self.depth, self.thickness), np.interp(depth, self.depth, density)
