"""Spar buoys in MoorDyn: an upright massless rod on a free body that cannot rotate.

A rod, unlike a point, accounts for the water surface. The body carries the mass and so large a moment of inertia
that the rod stays upright. It has three translations, as a `[[buoy]]` does.
"""

from __future__ import annotations

from dropper_jax.base.read import Table
from dropper_jax.decks.reading.sections import Row

#: Moment of inertia [kg m^2] above which a body counts as one that does not rotate.
UPRIGHT_INERTIA = 1e10
#: Number of segments of a rod that represents a buoy.
SEGMENTS = 10
#: Coefficients in the order of a rod type.
COEFFICIENTS = ("cdn", "can", "cdt", "cat")
#: Numbers that a body's CdA or Ca may have: one for all axes; translation and rotation; x, y and z; all six.
BODY_PARTS = (1, 2, 3, 6)


def rod_values(rod: Row) -> tuple[float, Table]:
    """Mass per length [kg/m] of a rod by its type, and its diameter [m] and coefficients by their names in a scene."""
    for row in rod.deck.rows["rod types"]:
        if row.words[0] == rod.words[1]:
            row.need(7, "rod type")
            diameter, mass, *coefficients = row.values(1, 7, "rod type", 0.0)
            return mass, {"diameter": diameter, **dict(zip(COEFFICIENTS, coefficients, strict=True))}
    rod.refuse(f"rod type {rod.words[1]!r} is not in the file")


def spar(body: Row, rod: Row) -> Table | None:
    """`[[buoy]]` of a body and its rod, at the position of the body; None if they are not a spar."""
    body.need(13, "body")
    rod.need(9, "rod")
    mass, shape = rod_values(rod)
    inertia = min(body.parts(10, "I", (1, 3)))
    loads = [*body.values(5, 8, "r0, p0, y0"), body.value(11, "Volume"), *body.parts(12, "CdA", BODY_PARTS), mass]
    *base, height = rod.values(3, 9, "Xa to Zb")
    free = body.words[1].lower() == "free"
    if not free or inertia < UPRIGHT_INERTIA or any(loads) or any(base) or height <= 0.0:
        return None
    own = {"mass": body.value(8, "Mass", above=0.0), "height": height}
    return {"name": rod.name("buoy"), "row": rod.number, **own, **shape}
