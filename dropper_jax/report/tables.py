"""Tables of the report: rows in Markdown, of many lines those with the largest values."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from dropper_jax.base.markdown import markdown_table
from dropper_jax.base.read import Table
from dropper_jax.base.table_cells import Columns, record_cells

#: The rows of a section, or why it is left out.
Rows = list[Table] | dict[str, str]
#: Maximum number of lines in one table, those with the largest values; report.json has all.
SECTION_ROWS = 30

Item = TypeVar("Item")


def table_of(columns: Columns, rows: Iterable[Table]) -> str:
    """Rows as a Markdown table."""
    return markdown_table(list(columns), *(record_cells(row, columns) for row in rows))


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
            rows.append(record_cells(lines[i], columns))
        after = i + 1
    text = markdown_table(list(columns), *rows)
    if len(shown) == len(lines):
        return text
    return f"{text}\n\nThe {which} {len(shown)} of {len(lines)} {what}; report.json has all."
