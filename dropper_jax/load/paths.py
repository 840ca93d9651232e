"""Values of a scene by path: `effects.linear_damping.b_l`, `line.0.mass`, `point.right.position.0`.

The user's form of lines with types: types, sections and attached points, before they become one value per link.

A `Scene` holds one value per link (`line_types.expand`). Values changed by path have the same meaning as in the file:
`line.leg.length` is the length of the line, `line_type.chain.EA` that of every line of the type.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from dropper_jax.axial import LAWS
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Plain, ScenePath, Table, Values, declared_fields, join, plain, section_keys
from dropper_jax.effects import EFFECTS
from dropper_jax.integrators import OPTIONS
from dropper_jax.load.line_types import COEFFICIENTS, OF_SECTIONS, LineType, expand, law_constants
from dropper_jax.scene import (
    AnchorSpec,
    BodySpec,
    BuoySpec,
    FailureSpec,
    FitSpec,
    GrowthSpec,
    LineSpec,
    PointSpec,
    RunSpec,
    SeasonSpec,
    StartSpec,
    VesselSpec,
)
from dropper_jax.scene.body import CylinderSpec, SphereSpec
from dropper_jax.scene.fit import PriorSpec, SensorSpec
from dropper_jax.scene.length_in_time import LengthInTimeSpec, WinchSpec
from dropper_jax.scene.vessel import RaoSpec
from dropper_jax.sea.spec import CurrentSpec, LevelSpec, SeaSpec, WaveSpec

#: Keys and numbers that lead from a scene's table to a value.
Steps = tuple[str | int, ...]
Branch = Table | list[Any]
#: A section of a scene: its path with `*` for the number or name of an item, its head in TOML, the class that declares
#: its keys.
SectionRow = tuple[str, str, type | None]

#: Keys that are read by hand, by section.
MORE_KEYS: dict[str, Iterable[str]] = {
    "": ("name", "description"),
    "run": OPTIONS,
    "line.*.axial": ("law", "EA", "damping", "strain", "tension"),
    "sea": ("packaged",),
}
#: Tables that have paths only for the keys that are given.
BY_NAME = ("vessel.*.rao", "vessel.*.attachments", "body.*.attachments")
#: Sections of whose tables only the keys have paths, not the tables themselves.
KEYS_ALONE = ("line.*",)
#: Sections of templates, of lines with types and of fits, whose values have no path in a scene with one value per link.
WITHOUT_PATHS = ("point_type.*", "line_type.*", "fit", "fit.sensor.*", "fit.prior.*", "parameters", "unit.*", "array.*")


def declared_sections(effects: Collection[str] | None = None) -> list[SectionRow]:
    """All sections of a scene in the order of a file, with those of these effects only, or with effects registered
    from outside."""
    named = [name for name in EFFECTS if effects is None or name in effects]
    return [
        ("", "", None),
        ("run", "[run]", RunSpec),
        ("point.*", "[[point]]", PointSpec),
        ("point_type.*", "[[point_type]]", PointSpec),
        ("line.*", "[[line]]", LineSpec),
        ("line.*.axial", "line.axial", None),
        ("line.*.growth", "line.growth", GrowthSpec),
        ("line.*.length_in_time.*", "[[line.length_in_time]]", LengthInTimeSpec),
        ("line.*.length_in_time.*.control", "line.length_in_time.control", WinchSpec),
        ("line_type.*", "[[line_type]]", LineType),
        ("buoy.*", "[[buoy]]", BuoySpec),
        ("body.*", "[[body]]", BodySpec),
        ("body.*.cylinders.*", "body.cylinders", CylinderSpec),
        ("body.*.spheres.*", "body.spheres", SphereSpec),
        ("vessel.*", "[[vessel]]", VesselSpec),
        ("vessel.*.rao", "vessel.rao", RaoSpec),
        *((f"effects.{name}", f"[effects.{name}]", EFFECTS[name]) for name in named),
        ("start", "[start]", StartSpec),
        ("growth", "[growth]", SeasonSpec),
        ("sea", "[sea]", SeaSpec),
        ("sea.waves", "[sea.waves]", WaveSpec),
        ("sea.current", "[sea.current]", CurrentSpec),
        ("sea.level", "[sea.level]", LevelSpec),
        ("failure.*", "[[failure]]", FailureSpec),
        ("anchor.*", "[[anchor]]", AnchorSpec),
        ("fit", "[fit]", FitSpec),
        ("fit.sensor.*", "[[fit.sensor]]", SensorSpec),
        ("fit.prior.*", "[[fit.prior]]", PriorSpec),
        ("parameters", "[parameters]", None),
        ("unit.*", "[unit.NAME]", None),
        ("array.*", "[[array]]", None),
    ]


def describe(path: str) -> Values:
    """Declaration of the value at a path, with `meaning`, `unit`, `low` and `high`; empty for keys read by hand."""
    section, _, key = ScenePath(path).stem.rpartition(".")
    for pattern, _, cls in declared_sections():
        if cls is not None and re.fullmatch(re.escape(pattern).replace(r"\*", r"[^.]+"), section):
            declared = declared_fields(cls)
            if key in declared:
                return declared[key].metadata
    return {}


def locate(table: Values, paths: Iterable[str] | None = None) -> dict[str, Steps]:
    """Steps to each value that a scene with one value per link may have, by path; without entries of lists.

    Args:
        paths: if given, only effects that the scene has or that one of these paths names, so that no other is imported.
    """
    found: dict[str, Steps] = {}
    effects = None
    if paths is not None:
        named = {path.split(".")[1] for path in paths if path.startswith("effects.")}
        effects = named.union(table.get("effects", ()))
    for pattern, _, cls in declared_sections(effects):
        if pattern not in (*WITHOUT_PATHS, *BY_NAME) and (pattern != "growth" or "growth" in table):
            found |= _steps(table, pattern, _keys_with_paths(pattern, cls))
    for pattern in BY_NAME:
        found |= _steps(table, pattern)
    return found


def _keys_with_paths(pattern: str, cls: type | None) -> list[str]:
    """Keys of a section that have paths, declared or read by hand."""
    if cls is None:
        return list(MORE_KEYS.get(pattern, ()))
    if pattern in KEYS_ALONE:
        return list(declared_fields(cls))
    return [*section_keys(cls), *MORE_KEYS.get(pattern, ())]


def locate_written(table: Values) -> dict[str, Steps]:
    """The same for types and lines of a table in its original form; empty without types."""
    if not table.get("line_type"):
        return {}
    of_types = [*declared_fields(LineType)]
    for law in LAWS:
        of_types += law_constants(law)
    lines = _steps(table, "line.*", ("name", "from", "to", "shelter", *OF_SECTIONS))
    for path, to in list(lines.items()):
        if to[-1] in OF_SECTIONS and "sections" in table["line"][to[1]]:
            del lines[path]
    return {
        **_steps(table, "line_type.*", of_types),
        **lines,
        **_steps(table, "line.*.sections.*", OF_SECTIONS),
        **_steps(table, "line.*.attach.*", ("point", "at")),
        **_steps(table, "line.*.growth", declared_fields(GrowthSpec)),
        **_steps(table, "line.*.length_in_time.*", declared_fields(LengthInTimeSpec)),
        **_steps(table, "line.*.length_in_time.*.control", declared_fields(WinchSpec)),
    }


def _steps(table: Values, pattern: str, keys: Iterable[str] | None = None) -> dict[str, Steps]:
    """Steps to these keys of every table at a pattern; without `keys`, to those that it has."""
    found = {}
    for path, to, own in _tables(table, list(filter(None, pattern.split(".")))):
        named = keys
        if named is None:
            named = own
        for key in named:
            found[join(path, key)] = (*to, key)
    return found


def _tables(
    table: Values | list[Any], words: list[str], path: str = "", to: Steps = ()
) -> Iterator[tuple[str, Steps, Values | list[Any]]]:
    """Path, steps and value of every table at the words of a pattern; items of lists by number and by name."""
    if not words:
        yield path, to, table
    elif isinstance(table, list):
        for i, item in enumerate(table):
            for label in dict.fromkeys((str(i), str(item.get("name", i)))):
                yield from _tables(item, words[1:], f"{path}.{label}", (*to, i))
    elif words[0] != "*":
        yield from _tables(table.get(words[0], {}), words[1:], join(path, words[0]), (*to, words[0]))


def set_value(
    table: Table,
    path: str,
    value: Plain,
    steps: Mapping[str, Steps] | None = None,
    candidates: Iterable[str] = (),
) -> None:
    """Set a value at a path of plain values; numbers at the end of the path are entries of a list.

    Args:
        steps: steps by path; default `locate`.
        candidates: further paths that the error line may suggest.

    Raises:
        SceneError: the path (with the nearest) or the entry does not exist.
    """
    if steps is None:
        steps = locate(table, [path])
    parent, key = _find_parent(table, path, steps, candidates)
    parent[key] = value


def get(table: Table, path: str, steps: Mapping[str, Steps] | None = None) -> Plain:
    """The plain value at a path.

    Raises:
        SceneError: the path or entry does not exist, or no value is given there.
    """
    if steps is None:
        steps = locate(table, [path])
    parent, key = _find_parent(copy.deepcopy(table), path, steps, ())
    if isinstance(parent, dict) and key not in parent:
        raise SceneError(f"{path}: is not given in the scene")
    return parent[key]


def _find_parent(
    table: Branch, path: str, steps: Mapping[str, Steps], candidates: Iterable[str]
) -> tuple[Any, str | int]:
    """The container of the value at a path, and its key in it; missing tables are created."""
    found = ScenePath(path).entry_of(steps)
    if found is None:
        known = {*steps, *candidates}
        if isinstance(table, dict) and path.startswith("effects."):
            known.update(locate(table))
        raise SceneError(f"{path}: unknown path; {_hint(path, known)}")
    stem, entries = found
    *parents, key = steps[stem]
    for step in parents:
        if isinstance(table, list):
            table = table[step]
        else:
            table = table.setdefault(step, {})
    for number in entries:
        if isinstance(table, dict):
            items = table.get(key)
        else:
            items = table[key]
        if not isinstance(items, list):
            raise SceneError(
                f"{path}: has no entries, its value is {items!r}; use the path without a number at its end"
            )
        if number >= len(items):
            raise SceneError(f"{path}: entry {number} does not exist; allowed: 0 to {len(items) - 1}")
        table = items
        key = number
    return table, key


def path_as_given(error: SceneError, given: Iterable[str]) -> SceneError:
    """The error of a changed table with the path that was given: with the name of a line or type, not its number."""
    path, colon, reason = str(error).partition(":")
    section, number, key = (*path.split(".", 2), "", "")[:3]
    same = [own for own in given if own.startswith(f"{section}.") and own.endswith(f".{key}")]
    if number.isdecimal() and key and len(same) == 1:
        return SceneError(f"{same[0]}{colon}{reason}")
    return error


def _hint(path: str, candidates: set[str]) -> str:
    """The nearest path, otherwise those of the same section, otherwise the sections."""
    shown = 20  # maximum number of valid paths listed in an error line
    hint = nearest(path, candidates)
    if not hint.startswith("known:") or len(candidates) <= shown:
        return hint
    sections = {ScenePath(p).section for p in candidates}
    if ScenePath(path).section not in sections:
        return f"known sections: {', '.join(sorted(sections))}"
    near = sorted(p for p in candidates if ScenePath(p).section == ScenePath(path).section)
    if len(near) > shown:
        near[shown:] = ["..."]
    return f"known: {', '.join(near)}"


def is_written(table: Table, path: str, written: Mapping[str, Steps]) -> bool:
    """Whether a path is that of a value in its original form, or of an entry of a list there."""
    stem, entries = ScenePath(path).entry_of(written) or ("", ())
    if entries:
        with suppress(SceneError):  # nothing is given there
            return isinstance(get(table, stem, written), list)
    return stem in written and not entries


@dataclass(frozen=True)
class Written:
    """The part of a scene that was expanded.

    Attributes:
        line_type, line: plain values of these sections.
        made: points created by `attach`.
        taken: (effect, key) of coefficients that came from line types or lines.
    """

    line_type: list[Table]
    line: list[Table]
    made: tuple[str, ...]
    taken: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, table: Values, expanded: Values) -> Written | None:
        """The expanded part of a scene's plain values; None if nothing was expanded."""
        if not table.get("line_type"):
            return None
        given = {point.get("name") for point in table.get("point", [])}
        made = tuple(p["name"] for p in expanded["point"] if p.get("name") not in given)
        effects = table.get("effects", {})
        taken = []
        for key, effect in {**COEFFICIENTS, "shelter": "morison_drag", "EI": "bending"}.items():
            if key in expanded["effects"].get(effect, {}) and key not in effects.get(effect, {}):
                taken.append((effect, key))
        return cls(plain(table["line_type"]), plain(table["line"]), made, tuple(taken))

    def table(self, expanded: Values, keep_points: bool = False) -> Table:
        """Plain values of the scene in its original form, from those with one value per link."""
        effects = {}
        for name, values in expanded["effects"].items():
            effects[name] = {key: value for key, value in values.items() if (name, key) not in self.taken}
        points = [p for p in expanded["point"] if keep_points or p["name"] not in self.made]
        own = {"line_type": copy.deepcopy(self.line_type), "line": copy.deepcopy(self.line)}
        return {**expanded, **own, "point": points, "effects": effects}

    def with_changes(self, expanded: Table, values: Values) -> Table:
        """Plain values in their original form with some changed by path; changes of single links are applied last.

        Args:
            expanded: plain values of the scene with one value per link.
        """
        sections = {ScenePath(path).section for path in values}
        table = self.table(expanded, keep_points="point" in sections)
        written = locate_written(table)
        own = [path for path in values if is_written(table, path, written)]
        single = {path: value for path, value in values.items() if path not in own and self._of_links(path)}
        for path, value in values.items():
            if path in own:
                set_value(table, path, value, written)
            elif path not in single:
                set_value(table, path, value, candidates=written)
        if not single:
            return table
        table = expand(table)
        for path, value in single.items():
            set_value(table, path, value, candidates=written)
        return table

    def _of_links(self, path: str) -> bool:
        """Whether a path that is not written refers to single links: of a line, or an entry of a coefficient of types.

        Raises:
            SceneError: the length of a line of sections, which has none; that of links is not what a user means.
        """
        if ScenePath(path).section != "line":
            return path.startswith(tuple(f"effects.{effect}.{key}." for effect, key in self.taken))
        stem, _, key = path.rpartition(".")
        for i, line in enumerate(self.line):
            here = stem in (f"line.{i}", f"line.{line.get('name', i)}")
            if here and key in OF_SECTIONS and "sections" in line:
                raise SceneError(f"{path}: the line has sections. Use {stem}.sections.0.{key} and so on")
        return True
