"""Stretches of equal links, which become MoorDyn's lines: their types, and the failures at their ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from dropper_jax.axial.tabulated import ForceTable
from dropper_jax.base.errors import Check, raises_first
from dropper_jax.base.read import Plain
from dropper_jax.decks.reading.bodies import SEGMENTS, UPRIGHT
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.load.scene import Scene
from dropper_jax.scene import BodySpec, FailureSpec

#: Digits of a value per metre that was stored per link: dividing by the link's length rounds the last ones.
DIGITS = 12
COEFFICIENTS = (
    ("bending", "EI"),
    ("morison_drag", "cdn"),
    ("morison_inertia", "can"),
    ("morison_drag", "cdt"),
    ("morison_inertia", "cat"),
)


@dataclass(frozen=True)
class Piece:
    """A stretch of equal links: the values of its line type, its number of links and its length [m].

    `table` holds the rows (strain, tension [N]) of a tabulated law; the EA of the type is then not used.
    """

    type: tuple[float, ...]
    links: int
    length: float
    table: tuple[tuple[float, float], ...] | None = None

    @property
    def kind(self) -> tuple[Any, ...]:
        """The values that two stretches of the same line type share."""
        return (*self.type, self.table)


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
    return [
        Piece(tuple(rows[a, :-1].tolist()), int(b - a), short(np.sum(line.length[a:b])), tables[a])
        for a, b in pairwise(cuts)
    ]


def _rows(table: ForceTable) -> tuple[tuple[float, float], ...]:
    return tuple(zip(table.strain.tolist(), table.tension.tolist(), strict=True))


def line_types(parts: list[list[Piece]]) -> dict[tuple[Any, ...], str]:
    """Names of the line types."""
    kinds: dict[tuple[Any, ...], str] = {}
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


# Rigid bodies and upright buoys as MoorDyn's rod types, bodies and rods


def body_numbers(scene: Scene) -> dict[str, int]:
    """Number of each `[[body]]` among MoorDyn's bodies, by name; those of the buoys come first."""
    return {body.name: len(scene.buoys) + i + 1 for i, body in enumerate(scene.bodies)}


@raises_first
def check_bodies(scene: Scene) -> Iterator[Check]:
    """Reject bodies whose forces a file would lack.

    Raises:
        SceneError: products of inertia, several rotations, spheres other than one about the centre of mass.
    """
    for i, body in enumerate(scene.bodies):
        yield (
            np.count_nonzero(body.attitude) > 1,
            f"body.{i}.attitude: {body.attitude.tolist()} is about several axes; MoorDyn's codes differ in their "
            "order; allowed: about one of x, y and z",
        )
        yield (
            len(body.spheres) > 1 or any(not np.allclose(s.centre, body.centre_of_mass) for s in body.spheres),
            f"body.{i}.spheres: MoorDyn's bodies have one volume, at their centre of mass; allowed: one sphere there",
        )
        yield (
            bool(np.any(body.inertia[3:])),
            f"body.{i}.inertia: {body.inertia.tolist()}: MoorDyn's bodies have no products of inertia. Use axes in "
            "which they are 0",
        )


def rule(words: str) -> str:
    """The line that starts a section."""
    return f"{'-' * 22} {words} {'-' * 40}"


def section(title: str, head: str, units: str, rows: list[str]) -> list[str]:
    """A section of a table."""
    return [rule(title), head, units, *rows]


def body_tables(scene: Scene) -> list[str]:
    """The sections of rod types, bodies and rods; those of buoys first."""
    types = []
    bodies = []
    rods = []
    for i, b in enumerate(scene.buoys):
        types.append(_row(f"buoy{i + 1}", b.diameter, 0.0, b.cdn, b.can, b.cdt, b.cat))
        base = scene.point(b.point).position  # in MoorDyn lines end at the base
        bodies.append(_row(i + 1, "Free", *base, "0 0 0", b.mass, "0", 100 * UPRIGHT, "0 0 0", f" ! name: {b.point}"))
        rods.append(
            _row(i + 1, f"buoy{i + 1}", f"Body{i + 1}", "0 0 0 0 0", b.height, SEGMENTS, "-", f" ! name: {b.name}")
        )
    for body, number in zip(scene.bodies, body_numbers(scene).values(), strict=True):
        bodies.append(_body(number, body))
        for c in body.cylinders:
            key = f"rod{len(rods) + 1}"
            types.append(_row(key, c.diameter, 0.0, c.cdn, c.can, c.cdt, c.cat))
            rods.append(_row(len(rods) + 1, key, f"Body{number}", *c.start, *c.end, c.slices, "-"))
    found = (
        ("ROD TYPES", "TypeName Diam Mass/m Cd Ca CdEnd CaEnd", "(name) (m) (kg/m) (-) (-) (-) (-)", types),
        (
            "BODIES",
            "ID Attachment X0 Y0 Z0 r0 p0 y0 Mass CG I Volume CdA Ca",
            "(#) (word) (m) (m) (m) (deg) (deg) (deg) (kg) (m) (kg-m^2) (m^3) (m^2) (-)",
            bodies,
        ),
        (
            "RODS",
            "ID RodType Attachment Xa Ya Za Xb Yb Zb NumSegs RodOutputs",
            "(#) (name) (word/ID) (m) (m) (m) (m) (m) (m) (-) (-)",
            rods,
        ),
    )
    return [row for title, head, units, rows in found if rows for row in section(title, head, units, rows)]


def _body(number: int, body: BodySpec) -> str:
    """A body with its mass, including that of its cylinders, which are written as massless rods."""
    centre, moments = ("|".join(repr(float(x)) for x in values[:3]) for values in (body.centre_of_mass, body.inertia))
    volume = 0.0
    area = 0.0
    added = 0.0
    for s in body.spheres:
        volume = np.pi * s.diameter**3 / 6.0
        area = s.cd * np.pi * s.diameter**2 / 4.0
        added = s.ca
    pose = ("Pinned" if body.pinned else "Free", *body.position, *np.degrees(body.attitude))
    return _row(number, *pose, body.mass, centre, moments, volume, area, added, f" ! name: {body.name}")


def _row(*values: str | int | float) -> str:
    return " ".join(repr(float(x)) if isinstance(x, float) else str(x) for x in values)
