"""`[line.growth]`: a layer of mussels on a line, and links with such a layer."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.errors import Check
from dropper_jax.base.fields import parameter, section
from dropper_jax.base.read import DeclaredSection, plain, short_text


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


@section
class GrowthSpec(DeclaredSection):
    """`[line.growth]`: a layer of mussels on the line, whose own mass and diameter are those of the bare rope.

    Linear between the given depths, constant outside them.
    """

    depth: np.ndarray = parameter("depths below the mean surface, rising", unit="m", shape="table", rising=1)
    thickness: np.ndarray = parameter("thickness of the layer at those depths", unit="m", shape="table", low=0.0)
    density: np.ndarray = parameter(
        "density of the layer, one or one per depth", unit="kg/m^3", shape="numbers", low=0.0
    )

    def checks(self) -> Iterator[Check]:
        depths = len(self.depth)
        for key, counts in (("thickness", (depths,)), ("density", (1, depths))):
            value = getattr(self, key)
            yield (
                np.size(value) not in counts,
                f"{key}: {short_text(plain(value))} has {np.size(value)} entries; allowed: "
                f"{' or '.join(map(str, counts))}",
            )

    def thickness_and_density(self, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Thickness [m] and density [kg/m^3] at depths [m]."""
        density = np.broadcast_to(self.density, self.depth.shape)
        return np.interp(depth, self.depth, self.thickness), np.interp(depth, self.depth, density)
