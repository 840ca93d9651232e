"""Lines with types, sections and attached points in their original form, before they become one value per link.

A `Scene` holds one value per link (`typed_lines.expand`). Values changed by path have the same meaning as in the file:
`line.leg.length` is the length of the line, `line_type.chain.EA` that of every line of the type.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass

from dropper_jax.axial import LAWS
from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import ScenePath, Table, Values, declared_fields, plain
from dropper_jax.load.line_sections import SECTION_KEYS
from dropper_jax.load.line_types import LineType, law_constants
from dropper_jax.load.paths import Steps, get, set_value, steps_to
from dropper_jax.load.typed_lines import COEFFICIENTS, breaking_load_warnings, expand
from dropper_jax.scene import GrowthSpec
from dropper_jax.scene.length_in_time import LengthInTimeSpec, WinchSpec


def locate_written(table: Values) -> dict[str, Steps]:
    """Steps to each value of the types and lines of a table in its original form, by path; empty without types."""
    if not table.get("line_type"):
        return {}
    of_types = list(declared_fields(LineType))
    for law in LAWS:
        of_types += law_constants(law)
    lines = steps_to(table, "line.*", ("name", "from", "to", "shelter", *SECTION_KEYS))
    for path, to in list(lines.items()):
        if to[-1] in SECTION_KEYS and "sections" in table["line"][to[1]]:
            del lines[path]
    return {
        **steps_to(table, "line_type.*", of_types),
        **lines,
        **steps_to(table, "line.*.sections.*", SECTION_KEYS),
        **steps_to(table, "line.*.attach.*", ("point", "at")),
        **steps_to(table, "line.*.growth", declared_fields(GrowthSpec)),
        **steps_to(table, "line.*.length_in_time.*", declared_fields(LengthInTimeSpec)),
        **steps_to(table, "line.*.length_in_time.*.control", declared_fields(WinchSpec)),
    }


def is_written(table: Table, path: str, written: Mapping[str, Steps]) -> bool:
    """Whether a path is that of a value in its original form, or of an entry of a list there."""
    stem, entries = ScenePath(path).entry_of(written) or ("", ())
    if entries:
        with suppress(SceneError):  # nothing is given there
            return isinstance(get(table, stem, written), list)
    return stem in written and not entries


@dataclass(frozen=True)
class OriginalLines:
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
    def of(cls, table: Values, expanded: Values) -> OriginalLines | None:
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

    def table(self, expanded: Values) -> Table:
        """Plain values of the scene in its original form, from those with one value per link."""
        effects = {}
        for name, values in expanded["effects"].items():
            effects[name] = {key: value for key, value in values.items() if (name, key) not in self.taken}
        points = [p for p in expanded["point"] if p["name"] not in self.made]
        own = {"line_type": copy.deepcopy(self.line_type), "line": copy.deepcopy(self.line)}
        return {**expanded, **own, "point": points, "effects": effects}

    def with_changes(self, expanded: Table, values: Values) -> Table:
        """Plain values in their original form with some changed by path; changes of single links are applied last.

        Points created by `attach` follow the ends of their line, except those with a changed value of their own.

        Args:
            expanded: plain values of the scene with one value per link.
        """
        table = self.table(expanded)
        table["point"] = copy.deepcopy(expanded["point"])
        written = locate_written(table)
        single = self.single_changes(expanded, values)
        for path, value in values.items():
            if is_written(table, path, written):
                set_value(table, path, value, written)
            elif path not in single:
                set_value(table, path, value, candidates=written)
        before = {point["name"]: point for point in expanded["point"] if point["name"] in self.made}
        table["point"] = [point for point in table["point"] if point != before.get(point["name"])]
        if not single:
            return table
        table = expand(table)
        for path, value in single.items():
            set_value(table, path, value, candidates=written)
        return table

    def single_changes(self, expanded: Values, values: Values) -> Table:
        """Those changes by path that are of single links, which the original form cannot hold."""
        table = self.table(expanded)
        written = locate_written(table)
        found = {}
        for path, value in values.items():
            if not is_written(table, path, written) and self._of_links(path):
                found[path] = value
        return found

    def warnings(self) -> Iterator[str]:
        """Warnings about values that the expanded lines do not have."""
        return breaking_load_warnings(self.line_type, self.line)

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
            if here and key in SECTION_KEYS and "sections" in line:
                raise SceneError(f"{path}: the line has sections. Use {stem}.sections.0.{key} and so on")
        return True
