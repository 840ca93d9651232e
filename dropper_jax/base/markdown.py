"""Markdown: texts that are displayed as written, tables and the numbers in them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

#: A table as text, its heading first.
Rows = list[tuple[str, ...]]
#: Characters that Markdown or HTML would interpret as markup inside a line; `_` and `-` inside words are not markup.
MARKUP = re.compile(r"([\\`*\[\]<>&#!~|]|(?<!\w)_|_(?!\w))")
HTML = {"<": "&lt;", ">": "&gt;", "&": "&amp;", "|": "&#124;"}
#: Text that a reader would turn into a link automatically.
ADDRESS = re.compile(r"(?i)\b(https?|ftp|mailto|javascript|file|data)(:)|\b(www)(\.)")


def literal(text: str) -> str:
    """A text on one line that is displayed exactly as written."""
    text = " ".join(str(text).split())
    return ADDRESS.sub(_break_address, MARKUP.sub(_escape_markup, text))


def _escape_markup(found: re.Match[str]) -> str:
    character = found[1]
    return HTML.get(character, f"\\{character}")


def _break_address(found: re.Match[str]) -> str:
    """The start of an address with its colon or dot as a number, so that readers do not recognise it."""
    start = found[1] or found[3]
    separator = found[2] or found[4]
    return f"{start}&#{ord(separator)};"


def prose(text: str, in_table: bool = False) -> str:
    """As `literal`, but text between backticks is code and is left unchanged."""
    parts = " ".join(str(text).split()).split("`")
    if len(parts) % 2 == 0:  # a backtick without its partner
        return literal(text)
    for i, part in enumerate(parts):
        if i % 2:
            parts[i] = _code(part, in_table)
        else:  # with its leading and trailing blanks
            parts[i] = re.sub(r"\S(.*\S)?", lambda found: literal(found[0]), part)
    return "".join(parts)


def _code(text: str, in_table: bool) -> str:
    if in_table and "|" in text:  # readers differ on escaped bars in code, but not on this form
        return f"<code>{''.join(HTML.get(letter, letter) for letter in text)}</code>"
    return f"`{text}`"


def markdown_table(head: Sequence[str], *rows: Sequence[str]) -> str:
    """A Markdown table from its heading and its rows."""
    lines = [" | ".join(map(literal, row)) for row in (head, *rows)]
    lines.insert(1, " | ".join(["---"] * len(head)))
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
