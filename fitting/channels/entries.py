"""Entries of the tables in a channels file: names, numbers, units, columns; errors give the path of the entry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Plain, Values, read_list, read_number, read_text, refuse
from dropper_jax.scene.fit import FIT_UNITS

#: Value of a missing entry.
Default = TypeVar("Default", float, None)


def check_unique_names(names: Sequence[str], section: str) -> None:
    """Reject names of tables of a section that are given twice."""
    for i, name in enumerate(names):
        if name in names[:i]:
            raise SceneError(f"{section}.{i}: duplicate name {name!r}; names must be unique")


def read_name(table: Values, path: str, default: str | None = None) -> str:
    """The name of a table; points of a default, such as a file's, become underscores, because names are in paths.

    Raises:
        SceneError: an empty name, one with a point, or none without a default.
    """
    if "name" not in table and default is None:
        raise SceneError(f"{path}.name: missing; needed: a name without a point")
    name = read_text(table.get("name", default), f"{path}.name")
    if not name.strip() or ("name" in table and "." in name):
        raise refuse(f"{path}.name", name, "cannot be used in the path of a parameter", "a name without a point")
    return name.replace(".", "_")


def require_value(table: Values, path: str, key: str, needed: str) -> Plain:
    """The value of a key.

    Raises:
        SceneError: the table does not have it.
    """
    if key not in table:
        raise SceneError(f"{path}.{key}: missing; needed: {needed}")
    return table[key]


def optional_number(table: Values, path: str, key: str, default: Default, **limits: float) -> float | Default:
    """The number at a key within limits (`low`, `above`, `high`); the default if it is missing."""
    if key in table:
        unit = {"delay": "s", "from": "s", "until": "s"}.get(key, "-")
        return read_number(table[key], f"{path}.{key}", {"unit": unit, **limits})
    return default


def read_vector(table: Values, path: str, key: str, count: int) -> np.ndarray:
    """The `count` numbers at a key."""
    items = read_list(require_value(table, path, key, f"{count} numbers"), f"{path}.{key}", count, f"{count} numbers")
    return np.array([read_number(x, f"{path}.{key}.{i}", {"unit": "-"}) for i, x in enumerate(items)])


def read_unit(table: Values, path: str, key: str, measures: str) -> str:
    """The unit at a key, one of a quantity whose SI unit is `measures`."""
    fitting = [name for name, (base, _) in FIT_UNITS.items() if base == measures]
    unit = read_text(require_value(table, path, key, ", ".join(fitting)), f"{path}.{key}")
    if unit not in fitting:
        raise SceneError(f"{path}.{key}: {unit!r} is not a unit of this quantity; allowed: {', '.join(fitting)}")
    return unit


def read_column_names(table: Values, path: str) -> tuple[str, ...]:
    """The names at `column` or `columns`, of which a table has one."""
    if ("column" in table) == ("columns" in table):
        often = "twice" if "column" in table else "nowhere"
        raise SceneError(f"{path}: names its columns {often}; allowed: column or columns")
    if "column" in table:
        return (read_text(table["column"], f"{path}.column"),)
    items = read_list(table["columns"], f"{path}.columns", None, "a list of names of columns")
    if not items:
        raise SceneError(f"{path}.columns: is empty; allowed: names of columns")
    return tuple(read_text(name, f"{path}.columns.{i}") for i, name in enumerate(items))


def read_axes(
    table: Values, path: str, names: Sequence[str], default: Sequence[str], columns: Sequence[str]
) -> tuple[int, ...]:
    """Numbers of a sensor's `axes` among these names.

    Raises:
        SceneError: an unknown axis, or another number of them than columns.
    """
    given = read_list(table.get("axes", list(default)), f"{path}.axes", None, f"a list of {', '.join(names)}")
    axes = tuple(names.index(read_text(name, f"{path}.axes.{i}", names)) for i, name in enumerate(given))
    if len(columns) != len(axes):
        raise SceneError(f"{path}.columns: {len(columns)} columns for {len(axes)} axes; allowed: one per axis")
    return axes
