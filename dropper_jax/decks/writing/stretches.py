"""Stretches of equal links, which become MoorDyn's lines, and the failures at their ends."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from dropper_jax.decks.writing.line_types import DIGITS, LineKind, short, table_rows, values_of_links
from dropper_jax.load.scene import Scene
from dropper_jax.scene import FailureSpec, LineSpec, sliced_lines


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
    kind: LineKind


def stretches(scene: Scene) -> list[Stretch]:
    """Stretches of equal links of all lines."""
    rows = values_of_links(scene)
    found = []
    for line, where in sliced_lines(scene):
        own = rows[where.links]
        tables = [None] * line.links
        if line.tables is not None:
            tables = list(map(table_rows, line.tables))
        same = np.all(np.abs(own[1:] - own[:-1]) <= 10.0**-DIGITS * np.abs(own[1:]), axis=1)
        same = same & np.array([a == b for a, b in pairwise(tables)], bool)
        cuts = [0, *(np.flatnonzero(~same) + 1).tolist(), line.links]
        names = [line.name]
        if len(cuts) > 2:
            names = [f"{line.name}-{i}" for i in range(1, len(cuts))]
        ends = [line.start, *names[:-1], line.end]
        for name, points, (a, b) in zip(names, pairwise(ends), pairwise(cuts), strict=True):
            diameter, mass, *rest, _ = own[a].tolist()
            kind = LineKind((diameter, short(mass), *rest), tables[a])
            found.append(Stretch(name, line, *points, a, b - a, short(np.sum(line.length[a:b])), kind))
    return found


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
