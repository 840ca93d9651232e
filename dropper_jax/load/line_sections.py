"""Sections of a line, each of one type, and points attached along it: the line cut into pieces between these points.

    [[line]] type, length, links       one section of one type, or
    [[line]] sections = [{type, length, links}, ...]
    [[line]] attach = [{point, at}]    points along the line, by arc length [m] from its first end

The pieces of a line are named `NAME-1`, `NAME-2`, ... from its first end on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import (
    DeclaredSection,
    Plain,
    Table,
    Values,
    count,
    read_fields,
    read_items,
    read_list,
    read_number,
    refuse,
)
from dropper_jax.load.line_types import LineType
from dropper_jax.scene.length_in_time import of_pieces
from dropper_jax.scene.line import LINK_LIMIT

#: Spacing of attached points, relative to the line's length, below which a piece would have no length.
SAME_POSITION = 1e-9
#: Length of a section inside a piece, relative to its own, up to which it only touches the piece: rounding of sums.
TOUCHING = 1e-9
#: Keys of a section of a line, or of a line without sections.
SECTION_KEYS = ("type", "length", "links")


@dataclass(frozen=True)
class Section(DeclaredSection):
    """A section of a line: its type, unstretched length [m] and number of links."""

    type: str = option("name of a [[line_type]]", type=str)
    length: float = parameter("length", unit="m", above=0.0)
    links: int = count("number of links", high=LINK_LIMIT)
    kind: LineType = field(kw_only=True)

    @classmethod
    def read(cls, table: Plain, path: str, types: Mapping[str, LineType]) -> Section:
        values = read_fields(cls, table, path, {})
        name = values["type"]
        if name not in types:
            raise SceneError(f"{path}.type: {name!r} is not a line type; {nearest(name, types)}")
        return cls(**values, kind=types[name])

    @property
    def link(self) -> float:
        """Length of a link [m]."""
        return self.length / self.links

    def cut(self, length: float) -> Section:
        """A part of it, with a proportional number of links, at least one."""
        return replace(self, length=length, links=max(1, round(self.links * length / self.length)))


@dataclass(frozen=True)
class AttachedPoint(DeclaredSection):
    """An entry of `attach`: a point along a line."""

    at: float = parameter("arc length from the first end of the line", unit="m")
    point: str | None = option("name of the point", type=str, default=None)

    def on(self, path: str, line: str, total: float) -> tuple[float, str]:
        """Arc length [m] and name of the point on a line of that name and length [m]."""
        if not SAME_POSITION * total < self.at < (1.0 - SAME_POSITION) * total:
            raise refuse(f"{path}.at", self.at, "is not on the line", f"above 0 and below its length, {total:g} m")
        return self.at, self.point or f"{line}-at-{self.at:g}"


def read_sections(line: Table, path: str, types: dict[str, LineType]) -> tuple[Section, ...]:
    """The sections of a line; removes their keys from it."""
    if "sections" not in line:
        return (Section.read({key: line.pop(key) for key in SECTION_KEYS if key in line}, path, types),)
    found = read_items(Section.read, line.pop("sections"), f"{path}.sections", types)
    if not found:
        raise refuse(f"{path}.sections", [], "is empty", "at least one {type, length, links}")
    return found


def _read_position(value: Plain) -> np.ndarray | None:
    """A position (3,) [m]; None if it is invalid, which is rejected when the point is read."""
    try:
        return np.array([read_number(x, "", {}) for x in read_list(value, "", 3, "")])
    except SceneError:
        return None


def split_line(
    line: Table, path: str, sections: Sequence[Section], points: list[Values]
) -> list[tuple[Table, Sequence[Section]]]:
    """The pieces between attached points. A point that the scene does not have is created, free, on the straight
    line."""
    attached = line.pop("attach", None)
    if attached is None:
        return [(line, sections)]
    total = sum(s.length for s in sections)
    name = line.get("name", "line")
    given = read_items(AttachedPoint.read, attached, f"{path}.attach")
    stops = sorted(stop.on(f"{path}.attach.{i}", name, total) for i, stop in enumerate(given))
    for (at, one), (further, other) in pairwise(stops):
        if further - at <= SAME_POSITION * total:
            raise SceneError(
                f"{path}.attach: {one!r} and {other!r} are both at {at:g} m; allowed: one point per position"
            )
    positions = {str(p.get("name")): p.get("position") for p in points}
    start = _read_position(positions.get(str(line.get("from"))))
    end = _read_position(positions.get(str(line.get("to"))))
    for at, stop in stops:
        if stop not in positions and start is not None and end is not None:
            position = start + (end - start) * at / total
            points.append({"name": stop, "kind": "free", "position": position.tolist()})
    changing = line.pop("length_in_time", None)
    found = []
    for (low, first), (high, last) in pairwise([(0.0, line.get("from")), *stops, (total, line.get("to"))]):
        piece = {**line, "name": f"{name}-{len(found) + 1}", "piece_of": name, "from": first, "to": last}
        found.append((piece, _between(sections, low, high)))
    if changing is not None:
        for (piece, _), own in zip(found, of_pieces(changing, f"{path}.length_in_time", len(found)), strict=True):
            piece["length_in_time"] = own
    return found


def _between(sections: Sequence[Section], low: float, high: float) -> list[Section]:
    """The part of the sections from arc length `low` to `high` [m]."""
    found = []
    start = 0.0
    for section in sections:
        length = min(high, start + section.length) - max(low, start)
        if length > TOUCHING * section.length:
            found.append(section.cut(length))
        start += section.length
    return found
