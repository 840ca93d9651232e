"""The user's form of lines with types: types, sections and attached points, before they become one value per link.

A `Scene` holds one value per link (`line_types.expand`). Values changed by path have the same meaning as in the file:
`line.leg.length` is the length of the line, `line_type.chain.EA` that of every line of the type.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import field_keys, plain
from dropper_jax.load.line_types import COEFFICIENTS, LineType, expand
from dropper_jax.load.paths import entry, set_value
from dropper_jax.scene import GrowthSpec

#: Keys of a `[[line]]` that are expanded, and of the tables in its lists.
LINE = ("name", "from", "to", "type", "length", "links", "shelter")
LISTS = {"sections": ("type", "length", "links"), "attach": ("point", "at")}


@dataclasses.dataclass(frozen=True)
class Written:
    """The part of a scene that was expanded.

    Attributes:
        line_type, line: plain values of these sections.
        made: points created by `attach`.
        taken: (effect, key) of coefficients that came from line types or lines.
    """

    line_type: list[dict[str, Any]]
    line: list[dict[str, Any]]
    made: tuple[str, ...]
    taken: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, table: Mapping[str, Any], expanded: Mapping[str, Any]) -> Written | None:
        """The expanded part of a scene's plain values; None if nothing was expanded."""
        if not table.get("line_type"):
            return None
        given = {point.get("name") for point in table.get("point", [])}
        made = tuple(p["name"] for p in expanded["point"] if p.get("name") not in given)
        effects = {name: values or {} for name, values in table.get("effects", {}).items()}
        keys = [(effect, key) for key, effect in COEFFICIENTS.items()] + [
            ("morison_drag", "shelter"),
            ("bending", "EI"),
        ]
        taken = tuple(
            (effect, key)
            for effect, key in keys
            if key in expanded["effects"].get(effect, {}) and key not in effects.get(effect, {})
        )
        return cls(plain(table["line_type"]), plain(table["line"]), made, taken)

    def table(self, expanded: Mapping[str, Any], keep_points: bool = False) -> dict[str, Any]:
        """Plain values of the scene in its original form, from those with one value per link."""
        effects = {
            name: {key: value for key, value in values.items() if (name, key) not in self.taken}
            for name, values in expanded["effects"].items()
        }
        points = [p for p in expanded["point"] if keep_points or p["name"] not in self.made]
        own = {"line_type": copy.deepcopy(self.line_type), "line": copy.deepcopy(self.line)}
        return {**expanded, **own, "point": points, "effects": effects}

    def with_changes(self, expanded: dict[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
        """Plain values in their original form with some changed by path; changes of single links are applied last.

        Args:
            expanded: plain values of the scene with one value per link.
        """
        table = self.table(expanded, keep_points=any(path.startswith("point.") for path in values))
        locations = self.locate_values(table)
        single = {path: value for path, value in values.items() if self._single(path, locations)}
        self._refuse_sections(single)
        for path, value in values.items():
            found = self.locate(path, locations)
            if found is not None:
                parent, key = found
                parent[key] = value
            elif path not in single:
                set_value(table, path, value, candidates=locations)
        if not single:
            return table
        table = expand(table)
        for path, value in single.items():
            set_value(table, path, value, candidates=locations)
        return table

    def _single(self, path: str, locations: Mapping[str, Any]) -> bool:
        """Whether a path refers to single links: of a line, or an entry of a coefficient given by types."""
        if path.startswith("line."):
            return self.locate(path, locations) is None
        return any(path.startswith(f"effects.{effect}.{key}.") for effect, key in self.taken)

    @staticmethod
    def locate(path: str, locations: Mapping[str, tuple[Any, Any]]) -> tuple[Any, Any] | None:
        """The container of the original value at a path, or of an entry of an original list, and its key; None for
        others."""
        if path in locations:
            return locations[path]
        stem, _, number = path.rpartition(".")
        if stem not in locations or not number.isdecimal():
            return None
        parent, key = locations[stem]
        return entry(parent[key], int(number), path)[:2] if isinstance(parent.get(key), list) else None

    def _refuse_sections(self, single: Mapping[str, Any]) -> None:
        """Reject the length of a line of sections: it has none of its own, and that of single links is not what a user
        means."""
        for i, line in enumerate(self.line):
            for key in ("type", "length", "links") if "sections" in line else ():
                for path in (f"line.{label}.{key}" for label in (i, line.get("name", i))):
                    if path in single:
                        stem = path.removesuffix(key)
                        raise SceneError(f"{path}: the line has sections. Use {stem}sections.0.{key} and so on")

    @staticmethod
    def locate_values(table: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
        """Positions of the values of types and lines in an original table, (parent, key) by path."""
        found: dict[str, tuple[Any, Any]] = {}

        def add(path: str, item: dict[str, Any], keys: Iterable[str]) -> None:
            found.update({f"{path}.{key}": (item, key) for key in keys})

        for section, keys in (("line_type", field_keys(LineType)), ("line", LINE)):
            for i, item in enumerate(table[section]):
                for label in (str(i), item.get("name", str(i))):
                    path = f"{section}.{label}"
                    add(path, item, keys if "sections" not in item else ("name", "from", "to", "shelter"))
                    for name, inner in LISTS.items() if section == "line" else ():
                        for k, part in enumerate(item.get(name, [])):
                            add(f"{path}.{name}.{k}", part, inner)
                    if "growth" in item:
                        add(f"{path}.growth", item["growth"], field_keys(GrowthSpec))
        return found
