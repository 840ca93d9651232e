"""A small table of names and values as HTML, for notebooks."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape


def html_table(title: str, rows: Iterable[tuple[str, ...]]) -> str:
    """A table with a title and rows of cells, the first of each a heading."""
    lines = [
        f"<tr><th style='text-align:left'>{escape(head)}</th>"
        + "".join(f"<td style='text-align:left'>{escape(cell)}</td>" for cell in cells)
        + "</tr>"
        for head, *cells in rows
    ]
    return f"<table><caption>{escape(title)}</caption>{''.join(lines)}</table>"
