"""Spar buoys in MoorDyn: an upright massless rod on a free body that cannot rotate.

A rod, unlike a point, accounts for the water surface. The body carries the mass and so large a moment of inertia that
the rod stays upright. It has three translations, as a `[[buoy]]` does.
"""

from __future__ import annotations

from typing import Any

from dropper_jax.moordyn.reading.sections import Deck, Row
from dropper_jax.moordyn.reading.values import columns, number, sizes

#: Moment of inertia [kg m^2] above which a body counts as one that does not rotate.
UPRIGHT = 1e10
#: Number of segments of a rod that represents a buoy.
SEGMENTS = 10


def rod_types(deck: Deck) -> dict[str, Row]:
    """Rows of the rod types by name."""
    return {row.words[0]: row for row in deck.rows.get("rod types", [])}


def spar(deck: Deck, body: Row, rod: Row, name: str) -> dict[str, Any] | None:
    """`[[buoy]]` of a body and its rod, with the position of its base under `position`; None if they are not a spar."""
    columns(deck, body, 14, "body")
    columns(deck, rod, 9, "rod")
    types = rod_types(deck)
    if rod.words[1] not in types:
        deck.refuse(rod.number, f"rod type {rod.words[1]!r} is not in the file")
    kind = types[rod.words[1]]
    columns(deck, kind, 7, "rod type")
    position = [number(deck, body, w, "X0, Y0, Z0") for w in body.words[2:5]]
    turned = [number(deck, body, w, "r0, p0, y0") for w in body.words[5:8]]
    inertia = min(sizes(deck, body, body.words[10], "I"))
    loads = [x for i in (11, 12) for x in sizes(deck, body, body.words[i], "Volume, CdA")]
    a = [number(deck, rod, w, "Xa, Ya, Za") for w in rod.words[3:6]]
    b = [number(deck, rod, w, "Xb, Yb, Zb") for w in rod.words[6:9]]
    diameter, mass, cdn, can, cdt, cat = (number(deck, kind, w, "rod type") for w in kind.words[1:7])
    upright = a == [0.0, 0.0, 0.0] and b[:2] == [0.0, 0.0] and b[2] > 0.0
    free = body.words[1].lower() == "free"
    if not (free and upright and mass == 0.0 and inertia >= UPRIGHT and not any(turned) and not any(loads)):
        return None
    return {
        "position": position,
        "name": name,
        "mass": number(deck, body, body.words[8], "Mass", 0.0, open_low=True),
        "diameter": diameter,
        "height": b[2],
        "cdn": cdn,
        "cdt": cdt,
        "can": can,
        "cat": cat,
    }
