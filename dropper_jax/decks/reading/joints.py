"""Lines of a deck that massless rods without length join end to end: one line of sections."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from dropper_jax.base.read import Table


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


@dataclass
class DeckLine:
    """A line of a deck: its name, the points at its ends A and B, its type, length [m] and number of links."""

    name: str
    start: str
    end: str
    type: str
    length: float
    links: int

    @property
    def section(self) -> Table:
        """Its values as a section of a line of the scene."""
        return {"type": self.type, "length": self.length, "links": self.links}


#: A line and whether it is passed from its end B to its end A.
Step = tuple[DeckLine, bool]


def join_lines(lines: list[DeckLine], joints: Collection[str]) -> tuple[list[Table], dict[str, Part]]:
    """The `[[line]]` tables, where lines that meet in pairs at joints are one line of `sections`, and the part of each
    line by its name.

    A joint with one line, or with more than two, stays a point. A joined line has the name of the first one of the
    deck.

    Args:
        lines: of the deck.
        joints: names of the points that may join lines.
    """
    lines_at: dict[str, list[DeckLine]] = {name: [] for name in joints}
    for line in lines:
        for end in {line.start, line.end} & lines_at.keys():
            lines_at[end].append(line)
    pairs = {name: ends for name, ends in lines_at.items() if len(ends) == 2}
    joined = []
    parts = {}
    for line in lines:
        if line.name in parts:
            continue
        steps = _chain(line, pairs)
        first = 0
        for own, turned in steps:
            parts[own.name] = Part(line.name, first, own.links, turned)
            first += own.links
        joined.append(_table(line.name, steps))
    return joined, parts


def _chain(line: DeckLine, pairs: dict[str, list[DeckLine]]) -> list[Step]:
    """A line with those before and after it; a closed ring stays in pieces."""
    after = list(_lines_beyond(line, False, pairs))
    if any(other is line for other, _ in after):
        return [(line, False)]
    before = list(_lines_beyond(line, True, pairs))
    return [*((own, not turned) for own, turned in reversed(before)), (line, False), *after]


def _lines_beyond(line: DeckLine, turned: bool, pairs: dict[str, list[DeckLine]]) -> Iterator[Step]:
    """The lines that follow a line past its last end, or past its first end if it is turned."""
    start = line
    end = line.start if turned else line.end
    while end in pairs:
        line = next(other for other in pairs[end] if other is not line)
        turned = line.end == end
        yield line, turned
        if line is start:
            return
        end = line.start if turned else line.end


def _table(name: str, steps: list[Step]) -> Table:
    """The `[[line]]` of lines one after another."""
    first, first_turned = steps[0]
    last, last_turned = steps[-1]
    sections = [own.section for own, _ in steps]
    return {
        "name": name,
        "from": first.end if first_turned else first.start,
        "to": last.start if last_turned else last.end,
        **(sections[0] if len(steps) == 1 else {"sections": sections}),
    }
