"""Parts, anchors and load cases of a site: the combinations, and the change of the scene by each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Plain, Table, read_list, read_text, refuse
from dropper_jax.base.records import names_of
from dropper_jax.load.scene import Scene
from dropper_jax.scene import LineSpec, whole_lines
from fitting.farm.site.sections import AnchorTable, Curve, Factors, SeaState

#: Kinds of states.
INTACT = "intact"
BROKEN = "broken"
#: Time [s] of breaks that belong to other cases: their entries stay in the one compiled program.
NEVER = 1e9
#: Fields of a current that cases keep: its profile over depth, but not its change in time.
PROFILE = ("kind", "exponent", "reference", "veer")
#: Maximum number of names in an error message.
MAX_NAMES = 6


@dataclass(frozen=True)
class Part:
    """Lines of one kind.

    Attributes:
        name: in reports.
        lines: names of its lines, as specified in the scene.
        capacity: (lines,) [N] breaking load; the minimum if the links of a line differ.
        factors: on its loads, with source, edition and clause.
        curve: its fatigue curve, or None.
        of_scene: whether the capacity is the breaking load of the scene's lines, and so follows its parameters.
    """

    name: str
    lines: tuple[str, ...]
    capacity: np.ndarray
    factors: Factors
    curve: Curve | None
    of_scene: bool


@dataclass(frozen=True)
class Anchor:
    """Fixed points of one kind, with their anchors and the factors on their loads."""

    name: str
    points: tuple[str, ...]
    table: AnchorTable
    factor: dict[str, float]


def match_names(patterns: Iterable[str], names: Sequence[str], path: str, what: str = "line") -> tuple[str, ...]:
    """Names that match any of the patterns, in order.

    Raises:
        SceneError: a pattern without a match (with the nearest name).
    """
    found = set()
    for pattern in patterns:
        own = [name for name in names if fnmatchcase(name, pattern)]
        if not own:
            hint = nearest(pattern, names)
            if hint.startswith("known:"):
                hint = f"known: {short(names)}"
            raise SceneError(f"{path}: {pattern!r} matches no {what}; {hint}")
        found.update(own)
    return tuple(name for name in names if name in found)


def read_patterns(given: Plain, path: str) -> list[str]:
    """A pattern of names, or a list of them."""
    if isinstance(given, str):
        return [given]
    return [read_text(item, path) for item in read_list(given, path, None, "patterns")]


def short(names: Sequence[str]) -> str:
    """The first names of a long list."""
    text = ", ".join(names[:MAX_NAMES]) or "none"
    if len(names) > MAX_NAMES:
        text += f", ... ({len(names)} in total)"
    return text


def find_owners(groups: Sequence[tuple[str, Sequence[str]]], what: str) -> dict[str, str]:
    """The path of the group of each name; groups are (path, names).

    Raises:
        SceneError: a name that belongs to two groups.
    """
    owner: dict[str, str] = {}
    for path, names in groups:
        for name in names:
            if name in owner:
                raise SceneError(f"{path}: {what} {name!r} already belongs to {owner[name]}; allowed: one of the two")
            owner[name] = path
    return owner


@dataclass(frozen=True)
class Break:
    """A state with a broken line: its label, the line (or piece of one) and link that breaks, and its `[[failure]]`."""

    name: str
    line: str
    link: int
    entry: int


@dataclass(frozen=True)
class Storm:
    """A load case without its seed.

    Attributes:
        number: from 0.
        direction: of the waves [rad]; `level`: of the tide [m].
        current: table of `[sea.current]`, None for that of the scene.
        current_name, month: names; month None for the bare scene.
        broken: the line that breaks; None for the intact farm.
        crop: which values of `[crop]`; None for those of the scene.
        periods: return periods of waves and current, as texts; None where they are not given.
    """

    number: int
    sea_state: SeaState
    direction: float
    current: Table | None
    current_name: str | None
    level: float
    month: str | None
    broken: Break | None
    crop: str | None = None
    periods: tuple[str | None, str | None] = (None, None)

    @property
    def state(self) -> str:
        """`intact`, or the name of the broken line."""
        if self.broken is None:
            return INTACT
        return self.broken.name

    @property
    def kind(self) -> str:
        """`intact` or `broken`: selects the factor."""
        return INTACT if self.broken is None else BROKEN

    @property
    def heading(self) -> float | None:
        """Direction of the current [rad]; None for that of the scene."""
        return None if self.current is None else self.current["direction"]

    @property
    def still(self) -> tuple[object, ...]:
        """The values that the equilibrium depends on."""
        return self.current_name, self.heading, self.level, self.month, self.crop

    @property
    def name(self) -> str:
        """A short label."""
        parts = [self.sea_state.name, f"{np.degrees(self.direction):g} deg", self.current_name]
        if self.level:
            parts.append(f"level {self.level:+g} m")
        parts.append(self.month)
        if self.crop:
            parts.append(f"crop {self.crop}")
        if self.broken is not None:
            parts.append(f"{self.state} broken")
        return ", ".join(filter(None, parts))


def name_waters(storms: Sequence[Storm]) -> list[str]:
    """Names of the equilibria of load cases: current and level, and what else differs between them."""
    names = [f"{storm.current_name or ''} level {storm.level:+g} m".strip() for storm in storms]
    headings = ["" if storm.heading is None else f"{np.degrees(storm.heading):g} deg" for storm in storms]
    for values in (headings, [storm.month for storm in storms], [storm.crop for storm in storms]):
        if len(set(values)) > 1:
            names = [f"{name} {value}" for name, value in zip(names, values, strict=True)]
    return names


@dataclass(frozen=True)
class Case:
    """A run: a load case with a seed."""

    storm: Storm
    seed: int


def breaks(scene: Scene, states: tuple[str, ...], path: str) -> tuple[Break | None, ...]:
    """States of `[cases]`: None for intact, otherwise the broken line; patterns give one state for each of their lines.

    A state has the name of its line, and of its link where several links of the line break in states of their own.

    Raises:
        SceneError: an unknown line or link, or a duplicate state.
    """
    lines = names_of(whole_lines(scene))
    found: list[Break | None] = []
    given_links: list[str] = []
    for i, state in enumerate(states):
        if state == INTACT:
            found.append(None)
            given_links.append("")
            continue
        pattern, colon, link = state.partition(":")
        if colon and not link.isdecimal():
            raise refuse(f"{path}.{i}", state, "has no link number after its colon", "LINE or LINE:LINK, links from 1")
        for name in match_names([pattern], lines, f"{path}.{i}"):
            entry = len(scene.failures) + len(found) - found.count(None)
            found.append(Break(name, *_locate_link(scene, name, link, f"{path}.{i}"), entry))
            given_links.append(link)
    broken_lines = [state.name for state in found if state is not None]
    for i, (state, link) in enumerate(zip(found, given_links, strict=True)):
        if state is not None and link and broken_lines.count(state.name) > 1:
            found[i] = replace(state, name=f"{state.name}:{link}")
    names = [INTACT if state is None else state.name for state in found]
    for name in names:
        if names.count(name) > 1:
            raise refuse(path, name, "is given twice", "every state once")
    return tuple(found)


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
