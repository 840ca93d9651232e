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
    """A line of a deck: its name, the points at its ends A and B, its type, length [m], number of links, and its row in
    the file."""

    name: str
    start: str
    end: str
    type: str
    length: float
    links: int
    row: int


class Step(NamedTuple):
    """A line and whether it is passed from its end B to its end A."""

    line: DeckLine
    turned: bool

    @property
    def start(self) -> str:
        """The point before the line."""
        return self.line.end if self.turned else self.line.start

    @property
    def end(self) -> str:
        """The point after the line."""
        return self.line.start if self.turned else self.line.end


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
        joined.append(_table(line, steps))
    return joined, parts


def _chain(line: DeckLine, pairs: dict[str, list[DeckLine]]) -> list[Step]:
    """A line with those before and after it; a closed ring stays in pieces."""
    after = list(_lines_beyond(Step(line, False), pairs))
    if any(step.line is line for step in after):
        return [Step(line, False)]
    before = list(_lines_beyond(Step(line, True), pairs))
    return [*(Step(own, not turned) for own, turned in reversed(before)), Step(line, False), *after]


def _lines_beyond(step: Step, pairs: dict[str, list[DeckLine]]) -> Iterator[Step]:
    """The lines that follow a line past its last end, or past its first end if it is turned."""
    start = step.line
    while step.end in pairs:
        line = next(other for other in pairs[step.end] if other is not step.line)
        step = Step(line, line.end == step.end)
        yield step
        if line is start:
            return


def _table(line: DeckLine, steps: list[Step]) -> Table:
    """The `[[line]]` of lines one after another, with the name of `line`."""
    sections = [{"type": own.type, "length": own.length, "links": own.links} for own, _ in steps]
    found = {"name": line.name, "row": line.row, "from": steps[0].start, "to": steps[-1].end}
    if len(steps) == 1:
        return found | sections[0]
    return found | {"sections": sections}
