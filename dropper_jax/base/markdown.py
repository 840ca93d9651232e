"""Tables in Markdown, and the numbers in them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from dropper_jax.base.toml_text import literal

#: A table as text, its heading first.
Rows = list[tuple[str, ...]]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table from its heading and its rows."""
    return markdown_table([head, *rows])


def markdown_table(rows: Sequence[Sequence[str]]) -> str:
    """Rows as a Markdown table; the first one is the heading."""
    lines = [" | ".join(map(literal, row)) for row in rows]
    lines.insert(1, " | ".join(["---"] * len(rows[0])))
    return "\n".join(f"| {line} |" for line in lines)


def bullets(rows: Iterable[object]) -> str:
    """Rows as a Markdown list."""
    return "\n".join(f"- {row}" for row in rows)


def cell(value: float | None, form: str) -> str:
    """A number in a format such as `.3g`; `-` for None."""
    if value is None:
        return "-"
    return format(value, form)


def cells(values: Iterable[float | None], form: str) -> list[str]:
    """Numbers in one format."""
    return [cell(value, form) for value in values]


def text_row(template: str, *values: object) -> tuple[str, ...]:
    """A row of a table: the cells of a template, separated by "|", with values in braces as in `str.format`."""
    return tuple(part.format(*values) for part in template.split("|"))


def first_names(names: Sequence[str], most: int) -> str:
    """The first names of a list, and how many more there are."""
    more = ""
    if len(names) > most:
        more = f" and {len(names) - most} more"
    return ", ".join(names[:most]) + more
