"""States of a site: the intact farm, and lines that break."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import refuse
from dropper_jax.base.records import names_of
from dropper_jax.load.scene import Scene
from dropper_jax.scene import LineSpec, whole_lines
from fitting.farm.site.patterns import match_names

#: Kinds of states.
INTACT = "intact"
BROKEN = "broken"


@dataclass(frozen=True)
class Break:
    """A state with a broken line.

    Attributes:
        name: in reports.
        line, link: that breaks: the line, or the piece of a whole line, and its link, from 1.
        entry: number of its `[[failure]]` in the scenes of load cases.
    """

    name: str
    line: str
    link: int
    entry: int


def read_states(scene: Scene, states: Sequence[str], path: str) -> tuple[Break | None, ...]:
    """States of `[cases]`: None for intact, otherwise the broken line; patterns give one state for each of their lines.

    A state has the name of its line, and of its link where several links of the line break in states of their own.

    Raises:
        SceneError: an unknown line or link, or a duplicate state.
    """
    found: list[Break | None] = []
    for i, state in enumerate(states):
        if state == INTACT:
            found.append(None)
        else:
            entry = len(scene.failures) + len(found) - found.count(None)
            found += _breaks_of(scene, state, entry, f"{path}.{i}")
    lines = [_line_of(state) for state in found]
    for i, (state, line) in enumerate(zip(found, lines, strict=True)):
        if state is not None and lines.count(line) == 1:
            found[i] = replace(state, name=line)
    names = [INTACT if state is None else state.name for state in found]
    for name in names:
        if names.count(name) > 1:
            raise refuse(path, name, "is given twice", "every state once")
    return tuple(found)


def _breaks_of(scene: Scene, state: str, entry: int, path: str) -> list[Break]:
    """The breaks of a state `LINE` or `LINE:LINK`, where `LINE` may be a pattern; their entries count up from `entry`.

    Each has the state's form of name.
    """
    pattern, colon, link = state.partition(":")
    if colon and not link.isdecimal():
        raise refuse(path, state, "has no link number after its colon", "LINE or LINE:LINK, links from 1")
    found = []
    for number, line in enumerate(match_names([pattern], names_of(whole_lines(scene)), path), entry):
        found.append(Break(line + colon + link, *_locate_link(scene, line, link, path), number))
    return found


def _line_of(state: Break | None) -> str:
    """The line in the name of a state; of the intact farm none."""
    return "" if state is None else state.name.partition(":")[0]


def kinds_of(states: Sequence[Break | None]) -> tuple[str, ...]:
    """Kinds of states that occur: `intact`, `broken`."""
    kinds = []
    if None in states:
        kinds.append(INTACT)
    if any(states):
        kinds.append(BROKEN)
    return tuple(kinds)


def _locate_link(scene: Scene, name: str, link: str, path: str) -> tuple[str, int]:
    """Line or piece and link (from 1) of a link of a whole line; the middle link if the text is empty."""
    pieces: list[LineSpec] = [line for line in scene.lines if name in (line.name, line.piece_of)]
    total = sum(line.links for line in pieces)
    at = int(link) if link else total // 2 + 1
    if not 1 <= at <= total:
        raise refuse(path, f"{name}:{link}", "is not a link of it", f"{name}:1 to {name}:{total}")
    for line in pieces:
        if at <= line.links:
            break
        at -= line.links
    if line.rigid:
        raise SceneError(f"{path}: the links of {name!r} are rigid and do not break. Use a line that stretches")
    return line.name, at
