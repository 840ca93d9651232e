"""Stretches of equal links, which become MoorDyn's lines: their types, and the failures at their ends."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from dropper_jax.axial.force_table import ForceTable
from dropper_jax.base.read import Plain
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.load.scene import Scene
from dropper_jax.scene import FailureSpec

#: Digits of a value per metre that was stored per link: dividing by the link's length rounds the last ones.
DIGITS = 12
COEFFICIENTS = (
    ("bending", "EI"),
    ("morison_drag", "cdn"),
    ("morison_inertia", "can"),
    ("morison_drag", "cdt"),
    ("morison_inertia", "cat"),
)


#: Rows (strain, tension [N]) of a tabulated law.
Rows = tuple[tuple[float, float], ...]
#: Values and table of a line type.
Kind = tuple[tuple[float, ...], Rows | None]


@dataclass(frozen=True)
class Piece:
    """A stretch of equal links: the values of its line type, its number of links and its length [m].

    `table` holds the rows (strain, tension [N]) of a tabulated law; the EA of the type is then not used.
    """

    type: tuple[float, ...]
    links: int
    length: float
    table: Rows | None = None

    @property
    def kind(self) -> Kind:
        """What two stretches of the same line type share."""
        return self.type, self.table


def pieces(scene: Scene, index: int) -> list[Piece]:
    """Stretches of equal links of a line."""
    line = scene.lines[index]
    first = sum(other.links for other in scene.lines[:index])
    span = slice(first, first + line.links)
    total = scene.line.links

    def each(value: Plain) -> np.ndarray:
        return np.broadcast_to(np.asarray(0.0 if value is None else value, float), (total,))[span]

    coefficients = [each(scene.effects.get(effect, {}).get(key)) for effect, key in COEFFICIENTS]
    if line.axial_damping is None:
        damping = np.zeros(line.links)
    else:
        damping = line.axial_damping
    diameter = each(displaced_diameter(scene.line, scene))
    rows = np.stack([diameter, line.mass / line.length, line.EA, damping, *coefficients, line.length], axis=1)
    if line.tables is not None:
        tables = [_rows(table) for table in line.tables]
    else:
        tables = [None] * line.links
    same = np.all(np.abs(rows[1:] - rows[:-1]) <= 10.0**-DIGITS * np.abs(rows[1:]), axis=1)
    same = same & np.array([a == b for a, b in pairwise(tables)], bool)
    cuts = [0, *(np.flatnonzero(~same) + 1), line.links]
    rows[:, 1] = [short(mass) for mass in rows[:, 1]]
    found = []
    for a, b in pairwise(cuts):
        found.append(Piece(tuple(rows[a, :-1].tolist()), int(b - a), short(np.sum(line.length[a:b])), tables[a]))
    return found


def _rows(table: ForceTable) -> Rows:
    return tuple(zip(table.strain.tolist(), table.tension.tolist(), strict=True))


def line_types(parts: list[list[Piece]]) -> dict[Kind, str]:
    """Names of the line types."""
    kinds: dict[Kind, str] = {}
    for piece in (piece for part in parts for piece in part):
        kinds.setdefault(piece.kind, f"type{len(kinds) + 1}")
    return kinds


def short(x: float) -> float:
    return float(f"{x:.{DIGITS}g}")


class Detachment(NamedTuple):
    """Where MoorDyn detaches a line from a point: the stretch of the line, and whether at its first end."""

    stretch: int
    first: bool


def detachment(scene: Scene, failure: FailureSpec) -> Detachment | None:
    """Where a failure's link ends at a point of the file; None for other links, and if no link is specified."""
    if failure.link is None:
        return None
    names = [line.name for line in scene.lines]
    begin = 0
    for i, piece in enumerate(pieces(scene, names.index(failure.line))):
        if failure.link in (begin + 1, begin + piece.links):
            return Detachment(i, failure.link == begin + 1)
        begin += piece.links
    return None
