"""Stretches of equal links, which become MoorDyn's lines: their types, and the failures at their ends."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from dropper_jax.axial.force_table import ForceTable
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.load.scene import Scene
from dropper_jax.scene import FailureSpec, LineSpec, sliced_lines

#: Digits of a value per metre that was stored per link: dividing by the link's length rounds the last ones.
DIGITS = 12
COEFFICIENTS = (
    ("bending", "EI"),
    ("morison_drag", "cdn"),
    ("morison_inertia", "can"),
    ("morison_drag", "cdt"),
    ("morison_inertia", "cat"),
)


class Kind(NamedTuple):
    """What stretches of one line type share: its values, and the rows (strain, tension [N]) of a tabulated law.

    With a table the EA of the values is not used.
    """

    values: tuple[float, ...]
    table: tuple[tuple[float, float], ...] | None


class Stretch(NamedTuple):
    """A stretch of equal links.

    Attributes:
        name: of MoorDyn's line.
        line: the line of the scene.
        start, end: names of the points at its ends; joints between stretches of a line are named after these.
        first, links: its first link in the line, and its number of links.
        length: [m].
        kind: of its line type.
    """

    name: str
    line: LineSpec
    start: str
    end: str
    first: int
    links: int
    length: float
    kind: Kind


def stretches(scene: Scene) -> list[Stretch]:
    """Stretches of equal links of all lines."""
    rows = _values_of_links(scene)
    found = []
    for line, where in sliced_lines(scene):
        own = rows[where.links]
        tables = [None] * line.links
        if line.tables is not None:
            tables = list(map(_rows, line.tables))
        same = np.all(np.abs(own[1:] - own[:-1]) <= 10.0**-DIGITS * np.abs(own[1:]), axis=1)
        same = same & np.array([a == b for a, b in pairwise(tables)], bool)
        cuts = [0, *(np.flatnonzero(~same) + 1).tolist(), line.links]
        names = [line.name]
        if len(cuts) > 2:
            names = [f"{line.name}-{i}" for i in range(1, len(cuts))]
        ends = [line.start, *names[:-1], line.end]
        for name, points, (a, b) in zip(names, pairwise(ends), pairwise(cuts), strict=True):
            diameter, mass, *rest, _ = own[a].tolist()
            kind = Kind((diameter, short(mass), *rest), tables[a])
            found.append(Stretch(name, line, *points, a, b - a, short(np.sum(line.length[a:b])), kind))
    return found


def _values_of_links(scene: Scene) -> np.ndarray:
    """Values of a line type for each link (n, k), then the length [m]; zero where a scene has none."""
    line = scene.line
    columns = [displaced_diameter(line, scene), line.mass / line.length, line.EA, line.axial_damping]
    columns += [scene.effects.get(effect, {}).get(key) for effect, key in COEFFICIENTS]
    rows = np.zeros((line.links, len(columns) + 1))
    for i, values in enumerate([*columns, line.length]):
        if values is not None:
            rows[:, i] = values
    return rows


def _rows(table: ForceTable) -> tuple[tuple[float, float], ...]:
    return tuple(zip(table.strain.tolist(), table.tension.tolist(), strict=True))


def line_types(parts: Sequence[Stretch]) -> dict[Kind, str]:
    """Names of the line types."""
    kinds = dict.fromkeys(part.kind for part in parts)
    return {kind: f"type{i}" for i, kind in enumerate(kinds, start=1)}


def short(x: float) -> float:
    return float(f"{x:.{DIGITS}g}")


class Detachment(NamedTuple):
    """Where MoorDyn detaches a line from a point: number of the line, from 1, and name of the point."""

    number: int
    point: str


def detachment(parts: Sequence[Stretch], failure: FailureSpec) -> Detachment | None:
    """Where a failure's link ends at a point of the file; None for other links, and if no link is specified."""
    for number, part in enumerate(parts, start=1):
        if part.line.name == failure.line and failure.link == part.first + 1:
            return Detachment(number, part.start)
        if part.line.name == failure.line and failure.link == part.first + part.links:
            return Detachment(number, part.end)
    return None
