"""Cells of tables: texts with the values of a row, for the terminal and for Markdown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from string import Formatter
from typing import Any

from dropper_jax.base.constants import DEGREE

#: A row of a table: values by name.
Record = Mapping[str, Any]
#: The texts of a row's cells by the headings of their columns (see `fill`), or functions of the row.
Columns = Mapping[str, str | Callable[[Any], str]]
#: Loads [N] below this are rounding.
NO_LOAD = 1e-6


def newton(value: float) -> str:
    """A load [N] to four digits or whole newtons."""
    if abs(value) < NO_LOAD:
        return "0"
    if abs(value) >= 1000:
        return f"{value:.0f}"
    return f"{value:.4g}"


def yes_no(holds: bool) -> str:
    """`yes`, or a `NO` that is noticed."""
    if holds:
        return "yes"
    return "NO"


#: Words of a format besides those of Python.
WORDS: dict[str, Callable[[Any], Any]] = {
    "max": max,
    "min": min,
    "newton": newton,
    "percent": lambda share: 100 * share,
    "degrees": lambda angle: DEGREE * angle,
    "spaced": lambda text: text.replace("_", " "),
    "yes_no": yes_no,
}


class _NoValue(Exception):
    """A value of a cell is None."""


class _CellFormatter(Formatter):
    """Formats of one or more words, such as `max .3g`; values that are None, or parts of None, raise `_NoValue`."""

    def get_field(self, field_name: str, args: Sequence[Any], kwargs: Record) -> Any:
        try:
            return super().get_field(field_name, args, kwargs)
        except TypeError:  # None has no parts
            raise _NoValue from None

    def format_field(self, value: object, format_spec: str) -> str:
        if value is None:
            raise _NoValue
        for word in format_spec.split():
            if word in WORDS:
                value = WORDS[word](value)
            else:
                value = format(value, word)
        return str(value)


def fill(text: str, row: Record) -> str:
    """A text with values of a row, as in `{total_n[max]:newton} N|no load`: the part after the bar, by default `-`, is
    used if a value is None."""
    text, _, absent = text.partition("|")
    try:
        return _CellFormatter().vformat(text, (), row)
    except _NoValue:
        return absent or "-"


def record_cells(row: Record, columns: Columns) -> list[str]:
    """The cells of a row."""
    cells = []
    for cell in columns.values():
        if isinstance(cell, str):
            cells.append(fill(cell, row))
        else:
            cells.append(cell(row))
    return cells
