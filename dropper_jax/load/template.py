"""Scenes with parameters, repeated parts and arrays, and the plain scene to which they expand.

[parameters]                        numbers with names, or expressions of others
loops = 60
spacing = 2.5
span = "= loops * spacing"

[[line]]                            repeated for every value of the counters in `repeat`, k = 1 to 60
repeat = {k = "= loops"}
name = "loop-{k}"                   {...} in a text is an expression too
from = "a-{k}"
to = "b-{k}"
length = "= 8 + 0.1 * k"            a text that starts with = is replaced by its number

[unit.longline]                     points, lines and buoys that belong together
...
[[array]]                           the positions of such units; `name` is the prefix of the names in each
of = "longline"
repeat = {row = 3, column = [1, 4]}
name = "r{row}c{column}-"
origin = ["= 200 * column", "= 40 * row", 0.0]
heading = 30.0                      [deg] of the unit's x axis from the scene's, about the unit's origin
shared = {east-anchor = "anchor-{row}-{column + 1}", west-anchor = "anchor-{row}-{column}"}

[[point_type]]                      common values of points of a kind; `float` is a float of that volume [m^3]
name = "float-200"
float = 0.2
"""

from __future__ import annotations

import copy
import itertools
import math
import re
from collections import ChainMap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import (
    Plain,
    Table,
    Values,
    check_keys,
    join,
    read_integer,
    read_list,
    read_number,
    read_table,
    read_text,
)
from dropper_jax.base.records import column, without_keys
from dropper_jax.load.expressions import Number, evaluate

#: Sections that only templates have.
TEMPLATE_SECTIONS = ("parameters", "unit", "array", "point_type")
#: Sections whose items may be repeated, and that units may contain.
REPEATED_SECTIONS = ("point", "line", "buoy", "failure")
UNIT_SECTIONS = ("point", "line", "buoy")
LAYOUT_KEYS = ("name", "origin", "heading", "shared")
ARRAY_KEYS = ("of", "repeat", *LAYOUT_KEYS)
#: Maximum number of items created by one `repeat`: 200 longlines of 60 loops have 12 000.
MAX_COPIES = 20_000
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
BRACES = re.compile(r"\{([^{}]*)\}")


class Names(ChainMap[str, Any]):
    """Numbers by name: counters of the enclosing repetitions, then, in the last map, parameters evaluated on demand."""

    def __init__(self, *maps: Table) -> None:
        super().__init__(*maps)
        self._being_evaluated: list[str] = []

    def __getitem__(self, key: str) -> Number:
        value = super().__getitem__(key)
        path = f"parameters.{key}"
        if not isinstance(value, str):
            read_number(value, path, {})
            return value
        if key in self._being_evaluated:
            raise SceneError(f"{path}: circular reference: {' -> '.join([*self._being_evaluated, key])}")
        self._being_evaluated.append(key)
        try:
            return evaluate(value.lstrip().removeprefix("="), self, path)
        finally:
            self._being_evaluated.remove(key)


@dataclass(frozen=True)
class Template:
    """A scene in its original form, with parameters, repetitions and arrays.

    Attributes:
        table: plain values.
        changes: values later set in the plain scene, by path.
    """

    table: Table
    changes: Table = field(default_factory=dict)

    @classmethod
    def of(cls, table: Values) -> Template | None:
        """The template of a scene's plain values; None if it is already a plain scene."""
        items = itertools.chain.from_iterable(table.get(section, ()) for section in REPEATED_SECTIONS)
        if any(key in table for key in TEMPLATE_SECTIONS) or any({"repeat", "float"} & set(item) for item in items):
            return cls(copy.deepcopy(dict(table)))
        return None

    def with_changes(self, parameters: Values, changes: Values) -> Template:
        """The template with other values of parameters, by path, and further changes of the plain scene.

        Raises:
            SceneError: an unknown parameter (with the nearest).
        """
        table = copy.deepcopy(self.table)
        known = table.get("parameters", {})
        for path, value in parameters.items():
            known[_parameter_name(path, known)] = value
        return Template(table, {**self.changes, **changes})

    def value(self, path: str) -> Number:
        """The value of a parameter, by its path `parameters.NAME`.

        Raises:
            SceneError: the parameter does not exist (with the nearest), or it has no value.
        """
        names = Names(self._parameters())
        return names[_parameter_name(path, names)]

    def _parameters(self) -> Table:
        parameters = dict(read_table(self.table.get("parameters", {}), "parameters"))
        for name in parameters:
            if not NAME.match(name):
                raise SceneError(
                    f"parameters.{name}: is not a valid name; allowed: letters, digits and _, not starting with a digit"
                )
        return parameters

    def expand(self) -> tuple[Table, Plain]:
        """The scene without parameters, repetitions and arrays, and the types of its points."""
        names = Names(self._parameters())
        for name in names:  # all of them, used or not
            names[name]
        types = evaluate_values(self.table.get("point_type", []), names, "point_type")
        rest = without_keys(self.table, (*TEMPLATE_SECTIONS, *REPEATED_SECTIONS))
        found = evaluate_table(rest, names, "")
        for section in REPEATED_SECTIONS:
            items = _items(self.table, section, names)
            if section in self.table or items:
                found[section] = items
        for i, array in enumerate(self.table.get("array", ())):
            self._add_units(array, f"array.{i}", names, found)
        return found, types

    def _add_units(self, array: Values, path: str, names: Names, found: Table) -> None:
        """Add the units of an array to the scene."""
        check_keys(array, ARRAY_KEYS, path)
        units = self.table.get("unit", {})
        kind = read_text(array.get("of"), f"{path}.of", units)
        unit = units[kind]
        check_keys(unit, UNIT_SECTIONS, f"unit.{kind}")
        for inner in _repetitions(array, path, names):
            part = {section: _items(unit, section, inner, f"unit.{kind}.") for section in UNIT_SECTIONS}
            layout = _Layout.read(array, path, inner, set(column(part["point"], "name")))
            known = set(column(found.setdefault("point", []), "name"))
            points = [layout.point(point) for point in part["point"]]
            # a shared point has the position given by its first unit
            found["point"] += [point for point in points if point["name"] not in known]
            for section, keys in (("line", ("from", "to")), ("buoy", ("point",))):
                for item in part[section]:
                    found.setdefault(section, []).append(layout.item(item, keys))


@dataclass(frozen=True)
class _Layout:
    """The position of a unit, and the names of its parts there; `points` are the names of its points."""

    prefix: str
    origin: list[float]
    heading: float
    shared: Values
    points: set[str]
    path: str

    @classmethod
    def read(cls, array: Values, path: str, names: Names, points: set[str]) -> _Layout:
        given = evaluate_table({key: array.get(key) for key in LAYOUT_KEYS}, names, path)
        origin = read_list(given["origin"] or [0.0, 0.0, 0.0], f"{path}.origin", 3, "3 numbers")
        shared = read_table(given["shared"] or {}, f"{path}.shared")
        check_keys(shared, points, f"{path}.shared")
        return cls(
            read_text(given["name"], f"{path}.name"),
            [read_number(x, f"{path}.origin.{i}", {"unit": "m"}) for i, x in enumerate(origin)],
            math.radians(read_number(given["heading"] or 0.0, f"{path}.heading", {"unit": "deg"})),
            shared,
            points,
            path,
        )

    def name_of_point(self, name: str) -> str:
        """The name of a point of the scene, from that in the unit."""
        if name in self.shared:
            return self.shared[name]
        if name in self.points:
            return f"{self.prefix}{name}"
        return name

    def item(self, item: Table, keys: Sequence[str]) -> Table:
        """A line or buoy of the unit in the scene, whose `keys` name points."""
        found = {**item, "name": f"{self.prefix}{item['name']}"}
        for key in keys:
            if key in item:
                found[key] = self.name_of_point(item[key])
        if "attach" in item:
            found["attach"] = list(map(self._stop, item["attach"]))
        return found

    def _stop(self, stop: Table) -> Table:
        """A point along a line of the unit; without a name it has one after the line."""
        if "point" not in stop:
            return stop
        return {**stop, "point": self.name_of_point(stop["point"])}

    def point(self, point: Table) -> Table:
        """A point of the unit in the scene."""
        where = f"{self.path}, point {point['name']}"
        position = read_list(point.get("position"), where, 3, "3 numbers")
        x, y, z = (read_number(value, where, {"unit": "m"}) for value in position)
        cos = math.cos(self.heading)
        sin = math.sin(self.heading)
        moved = (cos * x - sin * y, sin * x + cos * y, z)
        position = [start + step for start, step in zip(self.origin, moved, strict=True)]
        return point | {"name": self.name_of_point(point["name"]), "position": position}


def _parameter_name(path: str, parameters: Values) -> str:
    """NAME of `parameters.NAME`."""
    name = path.partition(".")[2]
    if name not in parameters:
        raise SceneError(f"{path}: unknown parameter; {nearest(name, parameters)}")
    return name


def _items(table: Values, section: str, names: Names, before: str = "") -> list[Table]:
    """Items of a section; those with `repeat` once for every combination of its counters."""
    path = f"{before}{section}"
    found = evaluate_list(table.get(section, []), names, path)
    if before:  # names in units are prefixed, and needed before the scene is read
        for i, item in enumerate(found):
            read_text(item.get("name"), f"{path}.{i}.name")
    return found


def _repetitions(item: Values, path: str, names: Names) -> Iterator[Names]:
    """The names inside each repetition of an item; the first counter varies slowest."""
    if "repeat" not in item:
        return iter([names])
    repeat = read_table(item["repeat"], f"{path}.repeat")
    ranges = []
    count = 1
    for key, value in repeat.items():
        if not NAME.match(key) or key in names:
            raise SceneError(
                f"{path}.repeat.{key}: is invalid or already in use; allowed: letters, digits and _, "
                "not starting with a digit"
            )
        values = _read_range(value, f"{path}.repeat.{key}", names)
        ranges.append(values)
        count *= values.stop - values.start
        if count > MAX_COPIES:
            raise SceneError(f"{path}.repeat: creates more than {MAX_COPIES} parts; allowed: at most {MAX_COPIES}")
    return (names.new_child(dict(zip(repeat, each, strict=True))) for each in itertools.product(*ranges))


def _read_range(value: Plain, path: str, names: Names) -> range:
    """The values of a counter: from 1 to a count, or from first to last."""
    ends = value
    if not isinstance(value, list):
        ends = [1, value]
    ends = read_list(evaluate_values(ends, names, path), path, 2, "a count, or [first, last]")
    first, last = (_read_integral(end, path) for end in ends)
    if last - first < -1:
        given = ends
        if not isinstance(value, list):
            given = last
        raise SceneError(f"{path}: {given} makes {last - first + 1} copies; allowed: a count >= 0, or [first, last]")
    return range(first, last + 1)


def _read_integral(value: Plain, path: str) -> int:
    """A whole number, also if an expression gave it as a float."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return read_integer(value, path)


def evaluate_values(value: Plain, names: Names, path: str) -> Plain:
    """Plain values with all expressions evaluated."""
    match value:
        case Mapping():
            return evaluate_table(value, names, path)
        case list():
            return evaluate_list(value, names, path)
        case str() if value.lstrip().startswith("="):
            return evaluate(value.lstrip()[1:], names, path)
        case str() if not path.endswith(("description", "notes")):
            return BRACES.sub(lambda found: _text(evaluate(found[1], names, path)), value)
    return value


def evaluate_table(table: Values, names: Names, path: str) -> Table:
    """The same of a table."""
    return {key: evaluate_values(item, names, join(path, key)) for key, item in table.items()}


def evaluate_list(items: Sequence[Plain], names: Names, path: str) -> list[Any]:
    """The same of a list; an item with `repeat` once for every repetition."""
    found = []
    for i, item in enumerate(items):
        own = f"{path}.{i}"
        if not isinstance(item, Mapping) or "repeat" not in item:
            found.append(evaluate_values(item, names, own))
            continue
        once = {key: value for key, value in item.items() if key != "repeat"}
        found += [evaluate_table(once, inner, own) for inner in _repetitions(item, own, names)]
    return found


def _text(number: Number) -> str:
    if isinstance(number, float):
        return f"{number:g}"
    return str(number)
