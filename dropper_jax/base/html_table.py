"""Tables of notebooks."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape


def html_table(title: str, rows: Iterable[tuple[str, ...]]) -> str:
    """A table with a title and rows of cells, the first of each a heading."""
    lines = []
    for head, *cells in rows:
        row = f"<th style='text-align:left'>{escape(head)}</th>"
        for cell in cells:
            row += f"<td style='text-align:left'>{escape(cell)}</td>"
        lines.append(f"<tr>{row}</tr>")
    return f"<table><caption>{escape(title)}</caption>{''.join(lines)}</table>"
