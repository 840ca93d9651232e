"""Parts that a scene takes from the library: `type = "library:NAME"` of lines, their sections and points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Plain
from dropper_jax.load.library import PREFIX, part


def with_library(table: Mapping[str, Any]) -> dict[str, Any]:
    """The scene with the types that its lines take from the library added to its `[[line_type]]`.

    Raises:
        SceneError: an unknown part, or a part that is not a line.
    """
    own = {name for item in _tables(table.get("line_type")) if isinstance(name := item.get("name"), str)}
    wanted = {}
    for i, line in enumerate(_tables(table.get("line"))):
        paths = [(f"line.{i}.type", line)]
        paths += [(f"line.{i}.sections.{k}.type", s) for k, s in enumerate(_tables(line.get("sections")))]
        for path, item in paths:
            name = item.get("type")
            if isinstance(name, str) and name.startswith(PREFIX) and name not in own:
                wanted.setdefault(name, path)
    if not wanted:
        return dict(table)
    found = []
    for name, path in wanted.items():
        section, values = _at(path, name)
        if section != "line_type":
            raise SceneError(
                f"{path}: {name!r} is a part for points, not for lines; allowed: a rope, a chain or a crop"
            )
        found.append(values)
    return {**table, "line_type": [*_tables(table.get("line_type")), *found]}


def with_library_points(table: Mapping[str, Any]) -> dict[str, Any]:
    """The scene, its points and those of its units with the values that they take from the library written out.

    Raises:
        SceneError: an unknown part, or a part that is not a point.
    """
    found = dict(table)
    if "point" in found:
        found["point"] = _points(found["point"], "point")
    if isinstance(found.get("unit"), Mapping):
        found["unit"] = {
            name: {**unit, "point": _points(unit["point"], f"unit.{name}.point")}
            if isinstance(unit, Mapping) and "point" in unit
            else unit
            for name, unit in found["unit"].items()
        }
    return found


def _points(items: Plain, path: str) -> Plain:
    if not isinstance(items, list):
        return items
    return [_point(item, f"{path}.{i}.type") for i, item in enumerate(items)]


def _point(item: Plain, path: str) -> Plain:
    name = item.get("type") if isinstance(item, Mapping) else None
    if not isinstance(name, str) or not name.startswith(PREFIX):
        return item
    section, values = _at(path, name)
    if section != "point":
        raise SceneError(
            f"{path}: {name!r} is a part for lines, not for points; allowed: a float, such as library:float-0.2"
        )
    rest = {key: value for key, value in item.items() if key != "type"}
    return {**{key: value for key, value in values.items() if key != "name"}, **rest}


def _at(path: str, name: str) -> tuple[str, dict[str, Any]]:
    try:
        return part(name.removeprefix(PREFIX))
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None


def _tables(items: Plain) -> list[Any]:
    """The tables of a list; entries that are not tables are rejected later, with their names."""
    return [item for item in items if isinstance(item, Mapping)] if isinstance(items, list) else []
