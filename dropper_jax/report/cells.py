"""Cells of the report's tables: texts with the values of a row."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from string import Formatter
from typing import Any, TypeVar

from dropper_jax.base.constants import DEGREE
from dropper_jax.base.markdown import table
from dropper_jax.base.read import Table

#: The rows of a section, or why it is left out.
Rows = list[Table] | dict[str, str]
#: The texts of a row's cells by the headings of their columns (see `fill`), or functions of the row.
Columns = dict[str, str | Callable[[Table], str]]
#: Maximum number of lines in one table, those with the largest values; report.json has all.
SECTION_ROWS = 30
#: Limit of rounding.
SHOWN_ROUNDING = 1e-6

Item = TypeVar("Item")


def newton(value: float) -> str:
    """A load [N] to four digits or whole newtons."""
    if abs(value) < SHOWN_ROUNDING:
        return "0"
    if abs(value) >= 1000:
        return f"{value:.0f}"
    return f"{value:.4g}"


#: Words of a format besides those of Python.
WORDS: dict[str, Callable[[Any], Any]] = {
    "max": max,
    "min": min,
    "newton": newton,
    "percent": lambda share: 100 * share,
    "degrees": lambda angle: DEGREE * angle,
    "spaced": lambda text: text.replace("_", " "),
}


class _Filler(Formatter):
    """Formats of one or more words, such as `max .3g`."""

    def format_field(self, value: object, format_spec: str) -> str:
        if value is None:
            raise TypeError("the value does not exist")
        for word in format_spec.split():
            value = WORDS[word](value) if word in WORDS else format(value, word)
        return str(value)


def fill(text: str, row: Table) -> str:
    """A text with values of a row, as in `{total_n[max]:newton} N|no load`: the part after the bar, by default `-`, is
    used if a value is None."""
    text, _, absent = text.partition("|")
    try:
        return _Filler().vformat(text, (), row)
    except TypeError:
        return absent or "-"


def cells_of(columns: Columns, row: Table) -> list[str]:
    """The cells of a row."""
    return [fill(text, row) if isinstance(text, str) else text(row) for text in columns.values()]


def table_of(columns: Columns, rows: Iterable[Table]) -> str:
    """Rows as a Markdown table."""
    return table(list(columns), [cells_of(columns, row) for row in rows])


def largest(items: Sequence[Item], size: Callable[[Item], float], most: int = SECTION_ROWS) -> list[Item]:
    """The `most` largest, in their original order."""
    kept = sorted(range(len(items)), key=lambda i: -size(items[i]))[:most]
    return [items[i] for i in sorted(kept)]


def largest_table(
    lines: list[Table], size: Callable[[Table], float], columns: Columns, which: str = "largest", what: str = "lines"
) -> str:
    """The table of the `SECTION_ROWS` largest, and a note if there are more.

    Rows keep the order of the scene, with a count where others are left out.
    """
    shown = largest(range(len(lines)), lambda i: size(lines[i]))
    rows = []
    after = 0
    for i in [*shown, len(lines)]:
        if i > after:
            rows.append([f"({i - after} not shown)", *[""] * (len(columns) - 1)])
        if i < len(lines):
            rows.append(cells_of(columns, lines[i]))
        after = i + 1
    text = table(list(columns), rows)
    if len(shown) == len(lines):
        return text
    return f"{text}\n\nThe {which} {len(shown)} of {len(lines)} {what}; report.json has all."
