"""Values of a scene by path: `effects.linear_damping.b_l`, `line.0.mass`, `point.right.position.0`.

The user's form of lines with types: types, sections and attached points, before they become one value per link.

A `Scene` holds one value per link (`line_types.expand`). Values changed by path have the same meaning as in the file:
`line.leg.length` is the length of the line, `line_type.chain.EA` that of every line of the type.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Plain, field_keys, plain
from dropper_jax.effects import EFFECTS
from dropper_jax.integrators import OPTIONS
from dropper_jax.load.line_types import COEFFICIENTS, LineType, expand
from dropper_jax.scene import (
    AnchorSpec,
    BodySpec,
    BuoySpec,
    FailureSpec,
    GrowthSpec,
    LineSpec,
    PointSpec,
    RunSpec,
    SeasonSpec,
    StartSpec,
    VesselSpec,
)
from dropper_jax.sea.spec import SeaSpec

AXIAL = ("law", "EA", "damping", "strain", "tension")
#: Sections that are lists of tables, whose items are selected by number or name.
LISTED = ("point", "line", "buoy", "body", "vessel", "failure", "anchor")


def paths(table: Mapping[str, Any]) -> list[str]:
    """All paths of values that this scene may have, except list entries."""
    found = ["name", "description"]
    found += [f"run.{key}" for key in (*field_keys(RunSpec), *OPTIONS)]
    found += [f"start.{key}" for key in field_keys(StartSpec)]
    found += SeaSpec.paths()
    found += [f"growth.{key}" for key in SeasonSpec.all_keys()] if "growth" in table else []
    found += [f"effects.{name}.{key}" for name, cls in EFFECTS.items() for key in field_keys(cls)]
    line_keys = [*field_keys(LineSpec, LineSpec.KEYS), *(f"axial.{key}" for key in AXIAL)]
    line_keys += [f"growth.{key}" for key in field_keys(GrowthSpec)]
    for section, keys in (("point", field_keys(PointSpec)), ("line", line_keys), ("buoy", field_keys(BuoySpec))):
        for i, item in enumerate(table.get(section, [])):
            found += [f"{section}.{label}.{key}" for label in (i, item["name"]) for key in keys]
    found += [f"anchor.{i}.{key}" for i in range(len(table.get("anchor", []))) for key in field_keys(AnchorSpec)]
    found += [f"failure.{i}.{key}" for i in range(len(table.get("failure", []))) for key in field_keys(FailureSpec)]
    for i, item in enumerate(table.get("body", [])):
        found += [f"body.{label}.{key}" for label in (i, item["name"]) for key in _body_keys(item)]
    for i, item in enumerate(table.get("vessel", [])):
        keys = [*VesselSpec.keys(), *(f"attachments.{name}" for name in item.get("attachments", {}))]
        keys += [f"rao.{key}" for key in item.get("rao", {})]
        found += [f"vessel.{label}.{key}" for label in (i, item["name"]) for key in keys]
    return found


def _body_keys(item: Mapping[str, Any]) -> list[str]:
    """Keys of a body, those of its shapes by number and its attachments by name."""
    found = BodySpec.keys()
    for key, kind in BodySpec.SHAPES:
        keys = field_keys(kind, getattr(kind, "KEYS", None))
        found += [f"{key}.{i}.{name}" for i in range(len(item.get(key, []))) for name in keys]
    return found + [f"attachments.{name}" for name in item.get("attachments", {})]


def set_value(table: dict[str, Any], path: str, value: Plain, candidates: Iterable[str] = ()) -> None:
    """Set a value at a path of plain values; numbers at the end of the path are entries of a list.

    Args:
        candidates: further paths that the error line may suggest.

    Raises:
        SceneError: the path (with the nearest) or the entry does not exist.
    """
    parent, key = _find_parent(table, path, candidates)
    parent[key] = value


def get(table: dict[str, Any], path: str) -> Plain:
    """The plain value at a path.

    Raises:
        SceneError: the path or entry does not exist, or no value is given there.
    """
    parent, key = _find_parent(copy.deepcopy(table), path, ())
    if isinstance(parent, dict) and key not in parent:
        raise SceneError(f"{path}: is not given in the scene")
    return parent[key]


def _find_parent(table: dict[str, Any], path: str, candidates: Iterable[str]) -> tuple[Any, Any]:
    """The container of the value at a path, and its key in it; missing tables are created."""
    own = paths(table)
    field = next((p for p in sorted(own, key=len, reverse=True) if path == p or path.startswith(p + ".")), None)
    entries = [] if field is None else path[len(field) :].strip(".").split(".")
    entries = [] if entries == [""] else entries
    if field is None or not all(number.isdecimal() for number in entries):
        raise SceneError(f"{path}: unknown path; {_hint(path, {*own, *candidates})}")
    parent, key = _parent(table, field)
    for number in entries:
        parent, key, path = entry(parent.get(key) if isinstance(parent, dict) else parent[key], int(number), path)
    return parent, key


def _hint(path: str, candidates: set[str]) -> str:
    """The nearest path, otherwise those of the same section, otherwise the sections."""
    shown = 20  # maximum number of valid paths listed in an error line
    hint = nearest(path, candidates)
    if not hint.startswith("known:") or len(candidates) <= shown:
        return hint
    section = path.split(".")[0]
    near = sorted(p for p in candidates if p.split(".")[0] == section)
    if not near:
        return f"known sections: {', '.join(sorted({p.split('.')[0] for p in candidates}))}"
    return f"known: {', '.join(near[:shown])}{', ...' if len(near) > shown else ''}"


def _parent(table: dict[str, Any], field: str) -> tuple[dict[str, Any], str]:
    """The table that contains a known field, and the field's key in it; missing tables are created."""
    section, _, rest = field.partition(".")
    if not rest:
        return table, section
    if section not in LISTED:
        *tables, key = rest.split(".")
        parent = table.setdefault(section, {})
    else:
        items = table[section]
        label, item = next(
            (label, item)
            for i, item in enumerate(items)
            for label in (str(i), item.get("name", str(i)))
            if rest.startswith(label + ".")
        )
        *tables, key = rest[len(label) + 1 :].split(".")
        parent = item
    for name in tables:
        parent = parent[int(name)] if isinstance(parent, list) else parent.setdefault(name, {})
    return parent, key


def entry(items: Plain, index: int, path: str) -> tuple[list[Any], int, str]:
    """A list that has an entry of that number, the number and the path."""
    if not isinstance(items, list):
        raise SceneError(f"{path}: has no entries, its value is {items!r}; use the path without a number at its end")
    if index >= len(items):
        raise SceneError(f"{path}: entry {index} does not exist; allowed: 0 to {len(items) - 1}")
    return items, index, path


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
