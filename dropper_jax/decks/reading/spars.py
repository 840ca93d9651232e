"""Spar buoys in MoorDyn: an upright massless rod on a free body that cannot rotate.

A rod, unlike a point, accounts for the water surface. The body carries the mass and so large a moment of inertia
that the rod stays upright. It has three translations, as a `[[buoy]]` does.
"""

from __future__ import annotations

from dropper_jax.base.read import Table
from dropper_jax.decks.reading.sections import Row

#: Moment of inertia [kg m^2] above which a body counts as one that does not rotate.
UPRIGHT = 1e10
#: Number of segments of a rod that represents a buoy.
SEGMENTS = 10


def rod_type(rod: Row) -> Row:
    """The row of a rod's type."""
    for row in rod.deck.rows["rod types"]:
        if row.words[0] == rod.words[1]:
            row.need(7, "rod type")
            return row
    rod.refuse(f"rod type {rod.words[1]!r} is not in the file")


def spar(body: Row, rod: Row) -> Table | None:
    """`[[buoy]]` of a body and its rod, at the position of the body; None if they are not a spar."""
    body.need(14, "body")
    rod.need(9, "rod")
    kind = rod_type(rod)
    turned = body.values(5, 8, "r0, p0, y0")
    inertia = min(body.parts(10, "I"))
    loads = [x for i in (11, 12) for x in body.parts(i, "Volume, CdA")]
    a = rod.values(3, 6, "Xa, Ya, Za")
    b = rod.values(6, 9, "Xb, Yb, Zb")
    diameter, mass, cdn, can, cdt, cat = kind.values(1, 7, "rod type")
    upright = a == [0.0, 0.0, 0.0] and b[:2] == [0.0, 0.0] and b[2] > 0.0
    free = body.words[1].lower() == "free"
    if not (free and upright and mass == 0.0 and inertia >= UPRIGHT and not any(turned) and not any(loads)):
        return None
    return {
        "name": rod.name("buoy"),
        "row": rod.number,
        "mass": body.value(8, "Mass", 0.0, open_low=True),
        "diameter": diameter,
        "height": b[2],
        "cdn": cdn,
        "cdt": cdt,
        "can": can,
        "cat": cat,
    }
