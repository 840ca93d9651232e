"""Anchors of fixed points and their capacity.

A dead weight slides at the horizontal load `mu (W - V)` and lifts at W (Coulomb), with its weight in water W and the
upward load V. A drag anchor in line with a second one keeps its capacity and passes the excess load on. A screw
(helical) anchor has the bearing capacity of its plates, each acting separately:

    Q = sum A (9 c + gamma' z N_q),   N_q = exp(pi tan phi) tan^2(45 deg + phi/2)

over plates of area A at depth z below the seabed in soil of undrained strength c (clay) or friction angle phi (sand)
and weight in water gamma' (individual bearing: Adams and Klym 1972; Hoyt and Clemence 1989; N_q: Reissner 1924). It is
valid for plates at least three diameters apart, the uppermost at least five below the seabed. The shaft's friction, and
gamma' z in clay, are neglected, which is conservative. Other anchors (drag anchors) have their tested capacity.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import chain

import numpy as np

from dropper_jax.base.errors import Check, raises_first
from dropper_jax.base.fields import option, parameter, section
from dropper_jax.base.read import DeclaredSection

#: Kinds of anchor and the keys that each requires.
KINDS = {"dead_weight": ("weight", "friction"), "tested": ("capacity",), "screw": ("plates", "depths")}
#: Further keys of a screw, which are optional.
OPTIONAL = ("strength", "friction_angle", "soil_weight", "bearing_factor", "lateral")
#: Bearing of a deep plate in clay over its undrained strength [-].
CLAY_BEARING = 9.0
#: Minimum depth and minimum spacing of plates [diameters].
SCREW_DEPTH = 5.0
SCREW_SPACING = 3.0


@section
class AnchorSpec(DeclaredSection):
    """`[[anchor]]`: the anchor of a fixed point.

    `dead_weight`: W [N] in water and mu; it slides at `H = mu (W - V)` and lifts at `V = W` (Coulomb). `tested`: the
    load [N] to which it was tested, in any direction. `screw`: see above. With `lateral` it stands upright and its
    utilisation is `V/Q + H/lateral`; otherwise it lies along the load and its utilisation is `|load|/Q`.
    """

    point: str = option("name of the fixed point", type=str)
    kind: str = option("how it holds", choices=tuple(KINDS), default="dead_weight")
    weight: float | None = parameter("weight in water", unit="N", above=0.0, default=None)
    friction: float | None = parameter("coefficient of friction on the seabed", unit="-", above=0.0, default=None)
    capacity: float | None = parameter("tested load", unit="N", above=0.0, default=None)
    plates: np.ndarray | None = parameter("diameters of the plates", unit="m", shape="table", above=0.0, default=None)
    depths: np.ndarray | None = parameter(
        "depths of the plates below the seabed, rising", unit="m", shape="table", above=0.0, default=None
    )
    strength: float | None = parameter("undrained strength of clay", unit="Pa", above=0.0, default=None)
    friction_angle: float | None = parameter("friction angle of sand", unit="rad", above=0.0, high=0.87, default=None)
    soil_weight: float | None = parameter("weight of the soil in water", unit="N/m^3", above=0.0, default=None)
    bearing_factor: float | None = parameter("N_q of sand in place of Reissner's", unit="-", above=0.0, default=None)
    lateral: float | None = parameter("horizontal capacity of an upright anchor", unit="N", above=0.0, default=None)
    safety_factor: float = parameter("required ratio of capacity to load", unit="-", low=1.0, default=1.5)
    behind: str | None = option(
        "fixed point in line with this one whose anchor takes the load above this one's capacity",
        type=str,
        default=None,
    )

    def checks(self) -> Iterator[Check]:
        needed = KINDS[self.kind]
        used = needed
        if self.kind == "screw":
            used = (*needed, *OPTIONAL)
        takes = f"kind {self.kind!r} takes {' and '.join(needed)}"
        for key in (*chain.from_iterable(KINDS.values()), *OPTIONAL):
            given = getattr(self, key) is not None
            yield given and key not in used, f"{key}: is not used; {takes}"
            yield not given and key in needed, f"{key}: missing; {takes}"
        if self.kind == "screw":
            yield from self._screw_checks()

    def _screw_checks(self) -> Iterator[Check]:
        """Check that plates are deep enough and far enough apart to act separately, in clay or in sand."""
        plates = np.asarray(self.plates)
        depths = np.asarray(self.depths)
        yield (
            len(plates) == 0 or len(plates) != len(depths),
            f"depths: has {len(depths)} entries; allowed: one for each entry of `plates`, >= 1",
        )
        shallowest = SCREW_DEPTH * plates[0]
        yield (
            depths[0] < shallowest,
            f"depths.0: {depths[0]:g} m is too shallow, the soil above would break out; allowed: >= "
            f"{shallowest:g} m, 5 diameters",
        )
        spacing = SCREW_SPACING * np.maximum(plates[:-1], plates[1:])
        for i in np.flatnonzero(np.diff(depths) < spacing * (1.0 - 1e-9)):
            yield (
                True,
                f"depths.{i + 1}: {depths[i + 1]:g} m is less than 3 diameters below the plate above; "
                f"allowed: >= {depths[i] + spacing[i]:g} m",
            )
        clay = self.strength is not None
        yield (
            clay == (self.friction_angle is not None),
            ": kind 'screw' takes `strength` (clay) or `friction_angle` (sand), one of them",
        )
        yield (
            not clay and self.soil_weight is None,
            "soil_weight: missing; a screw anchor in sand needs it, > 0 N/m^3",
        )
        for key in ("soil_weight", "bearing_factor"):
            unused = clay and getattr(self, key) is not None
            yield unused, f"{key}: is not used in clay, only with `friction_angle`"

    @property
    def screw_capacity(self) -> float:
        """Load [N] along its axis at which a screw anchor pulls out."""
        area = 0.25 * np.pi * self.plates**2
        if self.strength is not None:
            return np.sum(area) * CLAY_BEARING * self.strength
        factor = self.bearing_factor
        if factor is None:
            phi = self.friction_angle
            factor = np.exp(np.pi * np.tan(phi)) * np.tan(0.25 * np.pi + 0.5 * phi) ** 2
        return np.sum(area * self.soil_weight * self.depths) * factor

    def utilisation(self, horizontal: np.ndarray, upward: np.ndarray) -> np.ndarray:
        """Utilisation, load over capacity (...), for horizontal and upward loads [N]; the anchor fails at 1.

        For a dead weight `(H/mu + V)/W` with V not below 0: both loads may grow by the inverse of this factor.
        """
        across, upwards, any_direction = self.capacities
        up = np.maximum(upward, 0.0)
        if any_direction:
            return np.hypot(horizontal, up) / across
        return horizontal / across + up / upwards

    @property
    def capacities(self) -> tuple[float, float, bool]:
        """Horizontal and upward capacity [N], and whether they are one capacity for a load in any direction."""
        if self.kind == "dead_weight":
            return self.friction * self.weight, self.weight, False
        if self.lateral is not None:
            return self.lateral, self.screw_capacity, False
        if self.capacity is not None:
            return self.capacity, self.capacity, True
        return self.screw_capacity, self.screw_capacity, True


def utilisations(
    anchors: tuple[AnchorSpec, ...], loads: Mapping[str, tuple[np.ndarray, np.ndarray]]
) -> dict[str, np.ndarray]:
    """Utilisation, load over capacity (...), of each anchored point, from its horizontal and upward loads (...) [N].

    An anchor with another one `behind` it keeps its capacity. If its utilisation u exceeds 1, it passes the fraction
    `1 - 1/u` of its horizontal load on: drag anchors keep their capacity while they drag.
    """
    own = {anchor.point: anchor.utilisation(*loads[anchor.point]) for anchor in anchors}
    passed: dict[str, np.ndarray] = {}
    for anchor in anchors:
        if anchor.behind is not None:
            share = 1.0 - 1.0 / np.maximum(own[anchor.point], 1.0)
            passed[anchor.behind] = passed.get(anchor.behind, 0.0) + share * loads[anchor.point][0]
    for anchor in anchors:
        if anchor.point in passed:
            across, up = loads[anchor.point]
            own[anchor.point] = anchor.utilisation(across + passed[anchor.point], up)
    return own


@raises_first
def check_anchors(anchors: tuple[AnchorSpec, ...], held: list[str]) -> Iterator[Check]:
    """Check that anchors are those of fixed points, one a point, and that an anchor `behind` another has none behind
    itself."""
    points = [anchor.point for anchor in anchors]
    last = [anchor.point for anchor in anchors if anchor.behind is None]
    for i, anchor in enumerate(anchors):
        yield (
            anchor.point not in held,
            f"anchor.{i}.point: {anchor.point!r} is not a fixed point; allowed: {', '.join(held) or 'none'}",
        )
        yield (
            anchor.point in points[:i],
            f"anchor.{i}.point: {anchor.point!r} has an anchor already; allowed: one anchor for each point",
        )
        yield (
            anchor.behind not in (None, *last),
            f"anchor.{i}.behind: {anchor.behind!r} is not a point whose anchor has none behind itself; "
            f"allowed: {', '.join(last) or 'none'}",
        )
