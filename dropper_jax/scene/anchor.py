"""Anchors of held points: how much they hold.

A dead weight slides at the horizontal load `mu (W - V)` and lifts at W (Coulomb), with its weight in water W and the
upward load V. Others (screw anchors, drag anchors) hold what they were tested to: their soil is not modelled.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import Plain, read_fields

#: Kinds by the keys they need.
KINDS = {"dead_weight": ("weight", "friction"), "tested": ("capacity",)}


@dataclasses.dataclass(frozen=True, eq=False)
class AnchorSpec:
    """`[[anchor]]`: what holds a held point.

    `dead_weight`: W [N] in water and mu; it slides at `H = mu (W - V)` and lifts at `V = W` (Coulomb). `tested`: the
    load [N] it was tested to, in any direction.
    """

    point: str = option("name of the held point", type=str)
    kind: str = option("how it holds", choices=tuple(KINDS), default="dead_weight")
    weight: float | None = parameter("weight in water", unit="N", low=0.0, open_low=True, optional=True)
    friction: float | None = parameter("friction against the bed", unit="-", low=0.0, open_low=True, optional=True)
    capacity: float | None = parameter("load it was tested to", unit="N", low=0.0, open_low=True, optional=True)
    safety_factor: float = parameter("wanted between capacity and load", unit="-", low=1.0, default=1.5)

    @classmethod
    def read(cls, table: Plain, path: str, held: list[str]) -> AnchorSpec:
        anchor = cls(**read_fields(cls, table, path, {}))
        if anchor.point not in held:
            raise SceneError(f"{path}.point: {anchor.point!r} is no held point; allowed: {', '.join(held) or 'none'}")
        for key in ("weight", "friction", "capacity"):
            given, needed = getattr(anchor, key) is not None, key in KINDS[anchor.kind]
            if given != needed:
                what = "missing" if needed else "is not used"
                raise SceneError(f"{path}.{key}: {what}; kind {anchor.kind!r} takes {' and '.join(KINDS[anchor.kind])}")
        return anchor

    def utilisation(self, horizontal: np.ndarray, upward: np.ndarray) -> np.ndarray:
        """Load over what is held (...), for horizontal and upward loads [N]; 1 is where it gives way.

        Of a dead weight `(H/mu + V)/W` with V not below 0: the factor by which both loads may grow is its inverse.
        """
        up = np.maximum(upward, 0.0)
        if self.kind == "tested":
            return np.hypot(horizontal, up) / self.capacity
        return (horizontal / self.friction + up) / self.weight
