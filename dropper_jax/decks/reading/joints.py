"""Lines of a deck that massless rods without length join end to end: one line of sections."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any, NamedTuple


class Part(NamedTuple):
    """Where a line of a deck is in a line of the scene.

    Attributes:
        line: name of the line of the scene.
        first, links: its first link there, and its number of links.
        turned: whether its end A is the later one there.
    """

    line: str
    first: int
    links: int
    turned: bool


#: A line and whether it is passed from its end B to its end A.
Step = tuple[dict[str, Any], bool]


def join_lines(lines: list[dict[str, Any]], joints: Collection[str]) -> tuple[list[dict[str, Any]], dict[str, Part]]:
    """The lines, with those that meet in pairs at joints as one line of `sections`, and the part of each by its name.

    A joint with one line, or with more than two, stays a point. A joined line has the name of the first one of the
    deck.

    Args:
        lines: with `from`, `to`, `type`, `length` and `links`.
        joints: names of the points that may join lines.
    """
    lines_at: dict[str, list[dict[str, Any]]] = {name: [] for name in joints}
    for line in lines:
        for end in {line["from"], line["to"]} & lines_at.keys():
            lines_at[end].append(line)
    pairs = {name: ends for name, ends in lines_at.items() if len(ends) == 2}
    joined = []
    parts = {}
    for line in lines:
        if line["name"] in parts:
            continue
        steps = _chain(line, pairs)
        first = 0
        for own, turned in steps:
            parts[own["name"]] = Part(line["name"], first, own["links"], turned)
            first += own["links"]
        joined.append(line if len(steps) == 1 else _line_of_sections(line["name"], steps))
    return joined, parts


def _chain(line: dict[str, Any], pairs: dict[str, list[dict[str, Any]]]) -> list[Step]:
    """A line with those before and after it; a closed ring stays in pieces."""
    after = list(_lines_beyond(line, False, pairs))
    if any(other is line for other, _ in after):
        return [(line, False)]
    before = list(_lines_beyond(line, True, pairs))
    return [*((own, not turned) for own, turned in reversed(before)), (line, False), *after]


def _lines_beyond(line: dict[str, Any], turned: bool, pairs: dict[str, list[dict[str, Any]]]) -> Iterator[Step]:
    """The lines that follow a line past its last end, or past its first end if it is turned."""
    start = line
    end = line["from"] if turned else line["to"]
    while end in pairs:
        line = next(other for other in pairs[end] if other is not line)
        yield line, line["to"] == end
        if line is start:
            return
        end = line["from"] if line["to"] == end else line["to"]


def _line_of_sections(name: str, steps: list[Step]) -> dict[str, Any]:
    first, first_turned = steps[0]
    last, last_turned = steps[-1]
    return {
        "name": name,
        "from": first["to" if first_turned else "from"],
        "to": last["from" if last_turned else "to"],
        "sections": [{key: own[key] for key in ("type", "length", "links")} for own, _ in steps],
    }
