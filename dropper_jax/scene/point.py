"""Points and buoys of a scene."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from dropper_jax.base.errors import Check
from dropper_jax.base.fields import option, parameter, section
from dropper_jax.base.read import DeclaredSection


@section
class PointSpec(DeclaredSection):
    """`[[point]]`: where lines start and end."""

    name: str = option("name", type=str)
    position: np.ndarray = parameter("position", unit="m", shape="vector")
    kind: str = option("fixed or free", choices=("fixed", "free"), default="fixed")
    mass: float | None = parameter("mass of a body at the point", unit="kg", low=0.0, default=None)
    volume: float | None = parameter("its displaced volume", unit="m^3", low=0.0, default=None)
    drag_area: float | None = parameter("its drag coefficient times area", unit="m^2", low=0.0, default=None)
    added_mass: float | None = parameter("its added mass coefficient", unit="-", low=0.0, default=None)

    #: Name of the body or vessel that carries it, if it is an attachment of one.
    carrier: str | None = None

    #: Properties of a body at the point.
    BODY_FIELDS: ClassVar[tuple[str, ...]] = ("mass", "volume", "drag_area", "added_mass")

    def checks(self) -> Iterator[Check]:
        for key in self.BODY_FIELDS:
            value = getattr(self, key)
            yield (
                value is not None and not self.is_free,
                f"{key}: {value} has no effect on a fixed point; allowed: kind = 'free'",
            )

    @property
    def is_free(self) -> bool:
        """Whether it moves with the lines."""
        return self.kind == "free"

    @property
    def has_body(self) -> bool:
        """Whether any property of a body at the point is given."""
        return any(getattr(self, key) is not None for key in self.BODY_FIELDS)


@section
class BuoySpec(DeclaredSection):
    """`[[buoy]]`: an upright cylinder at a free point (see `effects.spar_buoys`)."""

    name: str = option("name", type=str)
    point: str = option("name of the point", type=str)
    mass: float = parameter("mass", unit="kg", above=0.0)
    diameter: float = parameter("diameter", unit="m", above=0.0)
    height: float = parameter("height", unit="m", above=0.0)
    attachment: float = parameter("height of the point above the base", unit="m", low=0.0, default=0.0)
    cdn: float = parameter("drag coefficient across", unit="-", low=0.0, default=1.0)
    cdt: float = parameter("drag coefficient of the base", unit="-", low=0.0, default=0.0)
    can: float = parameter("added mass coefficient across", unit="-", low=0.0, default=1.0)
    cat: float = parameter("added mass coefficient of the base", unit="-", low=0.0, default=0.0)
    end_added_mass: str = option(
        "reference volume of `cat`: a half sphere, or the submerged volume",
        choices=("hemisphere", "volume"),
        default="hemisphere",
    )

    def checks(self) -> Iterator[Check]:
        yield (
            self.attachment > self.height,
            f"attachment: {self.attachment} is above the buoy; allowed: 0 to its height, {self.height:g} m",
        )
