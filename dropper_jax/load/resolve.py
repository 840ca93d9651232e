"""A scene's plain values without library parts, templates and types: one pass, before they are read and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import (
    Plain,
    Table,
    Values,
    check_keys,
    declared_fields,
    read_items,
    read_number,
    read_table,
    read_text,
    short_text,
)
from dropper_jax.load.library import FLOAT_DENSITY, PREFIX, float_of, part
from dropper_jax.load.line_types import expand
from dropper_jax.load.paths import Written
from dropper_jax.load.template import Template
from dropper_jax.scene import PointSpec


class Resolved(NamedTuple):
    """A scene's values, and its original form.

    Attributes:
        table: plain values with one value per link.
        written: line types, sections and attached points in their original form; None without any.
        template: parameters, repetitions and arrays in their original form; None without any.
    """

    table: Table
    written: Written | None
    template: Template | None


def resolve(table: Plain) -> Resolved:
    """New names of keys, library parts, parameters and repetitions, types of points, then types of lines.

    Raises:
        SceneError: one line with the path, the value and what is allowed.
    """
    given = with_library_points(read_table(table, "scene"))
    template = Template.of(given)
    if template is not None:
        given = with_point_types(*template.expand())
    given = with_library_lines(given)
    expanded = expand(given)
    return Resolved(expanded, Written.of(given, expanded), template)


#: Paths of the one gravity of a scene, that of weights and that of the water.
GRAVITIES = ("effects.weight.gravity", "sea.gravity")


def with_one_gravity(table: Values) -> Table:
    """The scene with the gravity that only one of `[effects.weight]` and `[sea]` gives in both.

    Waves over weightless lines (gravity 0) keep their own.

    Raises:
        SceneError: two values.
    """
    effects = table.get("effects")
    sea = table.get("sea")
    if not isinstance(effects, Mapping) or not isinstance(sea, Mapping):
        return dict(table)
    weight = effects.get("weight")
    if not isinstance(weight, Mapping):
        return dict(table)
    given = weight.get("gravity")
    water = sea.get("gravity")
    if given is None and water is not None:
        return {**table, "effects": {**effects, "weight": {**weight, "gravity": water}}}
    weightless = given == 0.0 and "waves" in sea and "buoyancy" not in effects
    if given is not None and water is None and not weightless:
        return {**table, "sea": {**sea, "gravity": given}}
    if given != water and not weightless:
        raise SceneError(
            f"effects.weight.gravity: {short_text(given)} m/s^2, but sea.gravity is {short_text(water)} m/s^2; "
            "allowed: one value. Remove one of the two"
        )
    return dict(table)


def with_library_lines(table: Values) -> Table:
    """The scene with the types that its lines take from the library added to its `[[line_type]]`.

    Raises:
        SceneError: an unknown part, or a part that is not a line.
    """
    own = {name for item in _tables(table.get("line_type")) if isinstance(name := item.get("name"), str)}
    items = {f"line.{i}": line for i, line in enumerate(_tables(table.get("line")))}
    for path, line in list(items.items()):
        items |= {f"{path}.sections.{k}": section for k, section in enumerate(_tables(line.get("sections")))}
    wanted = {}
    for path, item in items.items():
        name = item.get("type")
        if isinstance(name, str) and name.startswith(PREFIX) and name not in own:
            wanted.setdefault(name, f"{path}.type")
    if not wanted:
        return dict(table)
    found = [_part_for(path, name, "line_type", "lines", "a rope, a chain or a crop") for name, path in wanted.items()]
    return {**table, "line_type": [*_tables(table.get("line_type")), *found]}


def with_library_points(table: Values) -> Table:
    """The scene, its points and those of its units with the values that they take from the library written out.

    Raises:
        SceneError: an unknown part, or a part that is not a point.
    """
    found = {**table, **_points(table, "")}
    if isinstance(found.get("unit"), Mapping):
        units = found["unit"].items()
        found["unit"] = {
            name: {**unit, **_points(unit, f"unit.{name}.")} if isinstance(unit, Mapping) else unit
            for name, unit in units
        }
    return found


def _points(table: Values, before: str) -> Table:
    """The points of a table, if it has a list of them."""
    items = table.get("point")
    if not isinstance(items, list):
        return {}
    return {"point": [_point(item, f"{before}point.{i}.type") for i, item in enumerate(items)]}


def _point(item: Plain, path: str) -> Plain:
    name = item.get("type") if isinstance(item, Mapping) else None
    if not isinstance(name, str) or not name.startswith(PREFIX):
        return item
    values = _part_for(path, name, "point", "points", "a float, such as library:float-0.2")
    given = {**values, **item}
    return {key: value for key, value in given.items() if key != "type" and (key != "name" or "name" in item)}


def _part_for(path: str, name: str, section: str, use: str, allowed: str) -> Table:
    try:
        found, values = part(name.removeprefix(PREFIX))
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    if found != section:
        other = "points" if use == "lines" else "lines"
        raise SceneError(f"{path}: {name!r} is a part for {other}, not for {use}; allowed: {allowed}")
    return values


def _tables(items: Plain) -> list[Values]:
    """The tables of a list; entries that are not tables are rejected later, with their names."""
    if isinstance(items, list):
        return [item for item in items if isinstance(item, Mapping)]
    return []


def with_point_types(table: Table, types: Plain) -> Table:
    """The scene with the values that its points take from types and from `float` written out; a point's own values
    win."""
    known = dict(read_items(_point_type, types, "point_type"))
    points = table.get("point", [])
    if not isinstance(points, Sequence) or isinstance(points, str):
        return table
    return {**table, "point": [_written_out(point, known, f"point.{i}") for i, point in enumerate(points)]}


def _point_type(item: Plain, path: str) -> tuple[str, Table]:
    """Name and values of a type of points."""
    own = dict(read_table(item, path))
    check_keys(own, {*declared_fields(PointSpec), "float", "float_density"} - {"position"}, path)
    return read_text(own.pop("name", None), f"{path}.name"), own


def _written_out(point: Plain, types: Mapping[str, Values], path: str) -> Plain:
    if not isinstance(point, Mapping):
        return point
    found = dict(point)
    if "type" in found:
        found = {**types[read_text(found.pop("type"), f"{path}.type", types)], **found}
    if "float" not in found and "float_density" in found:
        raise SceneError(f"{path}.float_density: is only used together with `float`, its volume [m^3]")
    if "float" not in found:
        return found
    volume = read_number(found.pop("float"), f"{path}.float", {"low": 0.0, "open_low": True, "unit": "m^3"})
    given = found.pop("float_density", FLOAT_DENSITY)
    density = read_number(given, f"{path}.float_density", {"low": 0.0, "unit": "kg/m^3"})
    return {**float_of(volume, density), **found}
