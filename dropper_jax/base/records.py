"""Records, which are objects with a name or tables by key: one column of many of them, and some keys of one."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from typing import Any, Protocol, TypeVar

Value = TypeVar("Value")


class Named(Protocol):
    """An object with a name."""

    @property
    def name(self) -> str: ...


Row = TypeVar("Row", bound=Mapping[str, Any])
NamedItem = TypeVar("NamedItem", bound=Named)


def names_of(items: Iterable[Named]) -> list[str]:
    """The names of objects, in their order."""
    return [item.name for item in items]


def by_name(items: Iterable[NamedItem]) -> dict[str, NamedItem]:
    """Objects by their name; of two with the same name the last one."""
    return {item.name: item for item in items}


def column(rows: Iterable[Any], key: Any) -> list[Any]:
    """The value of a key, or of an index, in each row."""
    return [row[key] for row in rows]


def rows_where(rows: Iterable[Row], key: str, value: object) -> list[Row]:
    """The rows with a value at a key."""
    return [row for row in rows if row[key] == value]


def select_keys(table: Mapping[str, Value], keys: Container[str]) -> dict[str, Value]:
    """The entries of a table whose keys are listed, in the order of the table."""
    return {key: value for key, value in table.items() if key in keys}


def without_keys(table: Mapping[str, Value], keys: Container[str]) -> dict[str, Value]:
    """The entries of a table whose keys are not listed."""
    return {key: value for key, value in table.items() if key not in keys}


def without_none(table: Mapping[str, Value | None]) -> dict[str, Value]:
    """The entries of a table that have a value."""
    return {key: value for key, value in table.items() if value is not None}
