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
import textwrap
from collections import ChainMap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from typing import Any

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import (
    Plain,
    ScenePath,
    Table,
    Values,
    check_keys,
    join,
    read_integer,
    read_list,
    read_number,
    read_table,
    read_text,
    refuse,
    short_text,
)
from dropper_jax.base.records import column, select_keys, without_keys, without_none
from dropper_jax.load.expressions import Number, evaluate, names_in

#: Sections that only templates have.
TEMPLATE_SECTIONS = ("parameters", "unit", "array", "point_type")
#: Sections whose items may be repeated, and that units may contain.
REPEATED_SECTIONS = ("point", "line", "buoy", "failure")
UNIT_SECTIONS = ("point", "line", "buoy")
LAYOUT_KEYS = ("name", "origin", "heading", "shared")
ARRAY_KEYS = ("of", "repeat", *LAYOUT_KEYS)
#: Values of the layout of a unit that does not give them.
DEFAULT_LAYOUT: Values = {"origin": [0.0, 0.0, 0.0], "heading": 0.0, "shared": {}}
#: Keys of a line, of a point along it or of a buoy that name points.
POINT_KEYS = ("from", "to", "point")
#: Texts of a scene in which nothing is an expression.
FREE_TEXTS = ("description", "notes")
#: Maximum distance between two positions of a shared point, relative to the size of the unit: above rounding, below any
#: intended distance.
SHARED_TOLERANCE = 1e-6
#: Maximum number of items created by one `repeat`: 200 longlines of 60 loops have 12 000.
MAX_COPIES = 20_000
#: Numbers by name: counters of the enclosing repetitions, then, in the last map, parameters.
Names = ChainMap[str, Number]
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
BRACES = re.compile(r"\{([^{}]*)\}")


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
        numbers = self._parameters()
        return numbers[_parameter_name(path, numbers)]

    def _parameters(self) -> dict[str, Number]:
        parameters = read_table(self.table.get("parameters", {}), "parameters")
        for name in parameters:
            if not NAME.match(name):
                raise SceneError(
                    f"parameters.{name}: is not a valid name; allowed: letters, digits and _, not starting with a digit"
                )
        return evaluate_parameters(parameters)

    def expand(self) -> tuple[Table, Plain]:
        """The scene without parameters, repetitions and arrays, and the types of its points."""
        names = ChainMap(self._parameters())
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
        points = found.setdefault("point", [])
        known_points = {point.get("name"): point for point in points}
        for inner in _repetitions(array, path, names):
            part = {section: _items(unit, section, inner, f"unit.{kind}") for section in UNIT_SECTIONS}
            layout = _Layout.read(array, path, inner, part["point"])
            for own in part["point"]:
                point = layout.point(own)
                known = known_points.setdefault(point["name"], point)
                if known is point:
                    points.append(point)
                else:
                    layout.check_known_point(own["name"], point, known)
            for section in ("line", "buoy"):
                for item in part[section]:
                    found.setdefault(section, []).append(layout.item(item))


@dataclass(frozen=True)
class _Layout:
    """The position of a unit, and the names of its parts there.

    Attributes:
        prefix: of the names of its parts.
        origin: its position (3,) [m].
        heading: of its x axis [rad].
        shared: names in the scene of the points that it shares with others, by those in the unit.
        points: names of its points.
        size: maximum distance of a point from the origin [m], at least 1 m.
        path: of the array.
    """

    prefix: str
    origin: list[float]
    heading: float
    shared: Mapping[str, str]
    points: set[str]
    size: float
    path: str

    @classmethod
    def read(cls, array: Values, path: str, names: Names, points: Sequence[Table]) -> _Layout:
        given = without_none(select_keys(array, LAYOUT_KEYS))
        layout = evaluate_table({**DEFAULT_LAYOUT, **given}, names, path)
        own = set(column(points, "name"))
        shared = read_table(layout["shared"], f"{path}.shared")
        check_keys(shared, own, f"{path}.shared")
        for key, name in shared.items():
            read_text(name, f"{path}.shared.{key}")
        return cls(
            read_text(layout.get("name"), f"{path}.name"),
            _read_position(layout["origin"], f"{path}.origin"),
            math.radians(read_number(layout["heading"], f"{path}.heading", {"unit": "deg"})),
            shared,
            own,
            max([1.0, *(math.hypot(*point["position"]) for point in points)]),
            path,
        )

    def name_of_point(self, name: str) -> str:
        """The name of a point of the scene, from that in the unit."""
        if name in self.shared:
            return self.shared[name]
        if name in self.points:
            return f"{self.prefix}{name}"
        return name

    def item(self, item: Table) -> Table:
        """A line or buoy of the unit in the scene."""
        found = {**self._with_scene_points(item), "name": f"{self.prefix}{item['name']}"}
        if "attach" in item:
            found["attach"] = list(map(self._with_scene_points, item["attach"]))
        return found

    def _with_scene_points(self, item: Table) -> Table:
        """A line, a point along it or a buoy, with the names of its points in the scene."""
        named = select_keys(item, POINT_KEYS)
        return item | {key: self.name_of_point(name) for key, name in named.items()}

    def point(self, point: Table) -> Table:
        """A point of the unit in the scene."""
        x, y, z = point["position"]
        cos = math.cos(self.heading)
        sin = math.sin(self.heading)
        moved = (cos * x - sin * y, sin * x + cos * y, z)
        position = [start + step for start, step in zip(self.origin, moved, strict=True)]
        return point | {"name": self.name_of_point(point["name"]), "position": position}

    def check_known_point(self, name: str, point: Table, known: Table) -> None:
        """Check that a point of the unit may be one that the scene has already.

        Args:
            name: its name in the unit.
            point, known: the point as this unit gives it, and that of the scene.

        Raises:
            SceneError: it is not in `shared`, or its position is another.
        """
        if name not in self.shared:
            allowed = "a prefix with unique names, or a point in `shared`"
            raise refuse(f"{self.path}.name", point["name"], "is used twice", allowed)
        here = point["position"]
        there = _read_position(known.get("position"), f"point.{known['name']}.position")
        if math.dist(here, there) > SHARED_TOLERANCE * self.size:
            raise SceneError(
                f"{self.path}.shared.{name}: {short_text(known['name'])} is at {_coordinates(there)}, but "
                f"at {_coordinates(here)} in this unit; allowed: one position"
            )


def _coordinates(position: Sequence[float]) -> str:
    """A position for an error line."""
    numbers = ", ".join(f"{x:.8g}" for x in position)
    return f"({numbers}) m"


def _read_position(value: Plain, path: str) -> list[float]:
    """Coordinates (3,) [m]."""
    position = read_list(value, path, 3, "3 numbers")
    return [read_number(x, f"{path}.{i}", {"unit": "m"}) for i, x in enumerate(position)]


def _parameter_name(path: str, parameters: Values) -> str:
    """NAME of `parameters.NAME`."""
    name = path.partition(".")[2]
    if name not in parameters:
        raise SceneError(f"{path}: unknown parameter; {nearest(name, parameters)}")
    return name


def evaluate_parameters(parameters: Values) -> dict[str, Number]:
    """Parameters as numbers, each evaluated once and after those that it refers to.

    Raises:
        SceneError: not a number or an expression, or expressions that refer to each other in a circle.
    """
    texts = {}
    referred = {}
    for name, value in parameters.items():
        path = f"parameters.{name}"
        if not isinstance(value, str):
            read_number(value, path, {})
            continue
        texts[name] = value.lstrip().removeprefix("=")
        referred[name] = [other for other in names_in(texts[name], path) if other in parameters]
    try:
        order = list(TopologicalSorter(referred).static_order())
    except CycleError as error:
        circle = error.args[1][::-1]
        chain = textwrap.shorten(" -> ".join(circle), 200, placeholder=" ...")
        raise SceneError(f"parameters.{circle[0]}: circular reference: {chain}") from None
    found = dict(parameters)
    for name in order:
        if name in texts:
            found[name] = evaluate(texts[name], found, f"parameters.{name}")
    return found


def _items(table: Values, section: str, names: Names, unit_path: str = "") -> list[Table]:
    """Items of a section of the scene or of a unit; those with `repeat` once for every combination of its counters."""
    path = join(unit_path, section)
    found = evaluate_list(table.get(section, []), names, path)
    if unit_path:
        for i, item in enumerate(found):
            _check_unit_item(item, section, f"{path}.{i}")
    return found


def _check_unit_item(item: Table, section: str, path: str) -> None:
    """Check what the layout of a unit changes in an item, before the scene is read.

    Raises:
        SceneError: a name that is not a text, or a position that is not 3 numbers.
    """
    read_text(item.get("name"), f"{path}.name")
    if section == "point":
        _read_position(item.get("position"), f"{path}.position")
    _check_point_names(item, path)
    for i, attached in enumerate(read_list(item.get("attach", []), f"{path}.attach", None, "a list of tables")):
        own_path = f"{path}.attach.{i}"
        _check_point_names(read_table(attached, own_path), own_path)


def _check_point_names(item: Values, path: str) -> None:
    """Check that a line, a point along it or a buoy names its points with texts."""
    for key, name in select_keys(without_none(item), POINT_KEYS).items():
        read_text(name, f"{path}.{key}")


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
        case str() if ScenePath(path).stem in FREE_TEXTS:
            return value
        case str() if value.lstrip().startswith("="):
            return evaluate(value.lstrip()[1:], names, path)
        case str():
            return BRACES.sub(lambda found: _text(evaluate(found[1], names, path)), value)
    return value


def evaluate_table(table: Values, names: Names, path: str) -> Table:
    """A table with all expressions in its values evaluated."""
    return {key: evaluate_values(item, names, join(path, key)) for key, item in table.items()}


def evaluate_list(items: Sequence[Plain], names: Names, path: str) -> list[Any]:
    """A list with all expressions in its items evaluated; an item with `repeat` once for every repetition."""
    found = []
    for i, item in enumerate(items):
        own = f"{path}.{i}"
        if not isinstance(item, Mapping) or "repeat" not in item:
            found.append(evaluate_values(item, names, own))
            continue
        once = without_keys(item, ("repeat",))
        found += [evaluate_table(once, inner, own) for inner in _repetitions(item, own, names)]
    return found


def _text(number: Number) -> str:
    """A number in a name, without its rounding: 3.0 is `3`, 3 * 0.1 is `0.3`."""
    return f"{number:.15g}"
