"""A scene's plain values without library parts, templates and types: one pass, before they are read and checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import (
    Plain,
    Table,
    Values,
    check_keys,
    declared_fields,
    plain,
    read_items,
    read_number,
    read_table,
    read_text,
    refuse,
    short_text,
)
from dropper_jax.load.library import FLOAT_DENSITY, PREFIX, float_of, part
from dropper_jax.load.original_lines import OriginalLines
from dropper_jax.load.template import Template
from dropper_jax.load.typed_lines import expand
from dropper_jax.scene import PointSpec


class Resolved(NamedTuple):
    """A scene's values, and its original form.

    Attributes:
        table: plain values with one value per link.
        written: line types, sections and attached points in their original form; None without any.
        template: parameters, repetitions and arrays in their original form; None without any.
    """

    table: Table
    written: OriginalLines | None
    template: Template | None


def resolve(table: Plain) -> Resolved:
    """New names of keys, library parts, parameters and repetitions, types of points, then types of lines.

    Raises:
        SceneError: one line with the path, the value and what is allowed.
    """
    given = with_library_points(with_tables(read_table(table, "scene")))
    template = Template.of(given)
    if template is not None:
        given = with_point_types(*template.expand())
    given = with_library_lines(given)
    expanded = expand(given)
    return Resolved(expanded, OriginalLines.of(given, expanded), template)


#: Sections that are lists of tables.
LISTED = ("point", "line", "buoy", "failure", "line_type", "point_type", "array")


def with_tables(table: Values, before: str = "") -> Table:
    """The scene, or one of its units, with its lists of tables and its tables as such: nothing that follows has to ask.

    Raises:
        SceneError: a section of another form.
    """
    found = dict(table)
    for section in LISTED:
        if section in found:
            found[section] = _tables(found[section], f"{before}{section}")
    for i, line in enumerate(found.get("line", ())):
        for key in ("sections", "attach"):
            if key in line:
                line[key] = _tables(line[key], f"{before}line.{i}.{key}")
    for section in ("effects", "sea", "unit"):
        if section in found:
            found[section] = dict(read_table(found[section], section))
    for name, values in found.get("effects", {}).items():
        found["effects"][name] = dict(read_table(values, f"effects.{name}"))
    for name, unit in found.get("unit", {}).items():
        found["unit"][name] = with_tables(read_table(unit, f"unit.{name}"), f"unit.{name}.")
    return found


def _tables(items: Plain, path: str) -> list[Table]:
    if not isinstance(items, list | tuple):
        raise refuse(path, items, "is not a list", f"one or more [[{path}]] tables")
    tables = [dict(read_table(plain(item), f"{path}.{i}")) for i, item in enumerate(items)]
    for i, table in enumerate(tables):
        if "name" in table:
            read_text(table["name"], f"{path}.{i}.name")
    return tables


#: Paths of the one gravity of a scene, that of weights and that of the water.
GRAVITIES = ("effects.weight.gravity", "sea.gravity")


def with_one_gravity(table: Values) -> Table:
    """The scene with the gravity that only one of `[effects.weight]` and `[sea]` gives in both.

    Waves over weightless lines (gravity 0) keep their own.

    Raises:
        SceneError: two values.
    """
    effects = table.get("effects", {})
    sea = table.get("sea")
    if sea is None or "weight" not in effects:
        return dict(table)
    given = effects["weight"].get("gravity")
    water = sea.get("gravity")
    if given is None and water is not None:
        return {**table, "effects": {**effects, "weight": {**effects["weight"], "gravity": water}}}
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
    types = table.get("line_type", [])
    own = [item.get("name") for item in types]
    items = {}
    for i, line in enumerate(table.get("line", ())):
        items[f"line.{i}"] = line
        for k, section in enumerate(line.get("sections", ())):
            items[f"line.{i}.sections.{k}"] = section
    from_library = {}
    for path, item in items.items():
        name = item.get("type")
        if isinstance(name, str) and name.startswith(PREFIX) and name not in own:
            from_library.setdefault(name, f"{path}.type")
    if not from_library:
        return dict(table)
    types = list(types)
    for name, path in from_library.items():
        types.append(_part_for(path, name, "line_type", "a rope, a chain or a crop"))
    return {**table, "line_type": types}


def with_library_points(table: Values, before: str = "") -> Table:
    """The scene, or one of its units, with the values that its points take from the library written out.

    Raises:
        SceneError: an unknown part, or a part that is not a point.
    """
    found = dict(table)
    if "point" in found:
        found["point"] = [_point(item, f"{before}point.{i}.type") for i, item in enumerate(found["point"])]
    if "unit" in found:
        units = found["unit"].items()
        found["unit"] = {name: with_library_points(unit, f"unit.{name}.") for name, unit in units}
    return found


def _point(item: Values, path: str) -> Values:
    name = item.get("type")
    if not isinstance(name, str) or not name.startswith(PREFIX):
        return item
    values = _part_for(path, name, "point", "a float, such as library:float-0.2")
    del values["name"]
    given = {**values, **item}
    del given["type"]
    return given


#: What uses the parts of the library, by their section.
USES = {"line_type": "lines", "point": "points"}


def _part_for(path: str, name: str, section: str, allowed: str) -> Table:
    """The values of a part of the library that belongs to a section."""
    try:
        found, values = part(name.removeprefix(PREFIX))
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    if found != section:
        raise SceneError(f"{path}: {name!r} is a part for {USES[found]}, not for {USES[section]}; allowed: {allowed}")
    return values


def with_point_types(table: Table, types: Plain) -> Table:
    """The scene with the values that its points take from types and from `float` written out; a point's own values
    win."""
    known = dict(read_items(_point_type, types, "point_type"))
    points = [_written_out(point, known, f"point.{i}") for i, point in enumerate(table.get("point", ()))]
    return {**table, "point": points}


def _point_type(item: Plain, path: str) -> tuple[str, Table]:
    """Name and values of a type of points."""
    own = dict(read_table(item, path))
    check_keys(own, {*declared_fields(PointSpec), "float", "float_density"} - {"position"}, path)
    return read_text(own.pop("name", None), f"{path}.name"), own


def _written_out(point: Values, types: Mapping[str, Values], path: str) -> Table:
    found = dict(point)
    if "type" in found:
        found = {**types[read_text(found.pop("type"), f"{path}.type", types)], **found}
    if "float" not in found and "float_density" in found:
        raise SceneError(f"{path}.float_density: is only used together with `float`, its volume [m^3]")
    if "float" not in found:
        return found
    volume = read_number(found.pop("float"), f"{path}.float", {"above": 0.0, "unit": "m^3"})
    given = found.pop("float_density", FLOAT_DENSITY)
    density = read_number(given, f"{path}.float_density", {"low": 0.0, "unit": "kg/m^3"})
    return {**float_of(volume, density), **found}
