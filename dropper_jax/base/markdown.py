"""Names and texts of users in Markdown as they are: no markup, no links, no HTML."""

from __future__ import annotations

import re

#: What Markdown or HTML would take for markup inside a line; `_` and `-` inside words are none.
MARKUP = re.compile(r"([\\\\`*\[\]<>&#!~|]|(?<!\w)_|_(?!\w))")
HTML = {"<": "&lt;", ">": "&gt;", "&": "&amp;", "|": "&#124;"}
#: What a reader would make a link of by itself.
ADDRESS = re.compile(r"(?i)\b(https?|ftp|mailto|javascript|file|data)(:)|\b(www)(\.)")


def literal(text: str) -> str:
    """A text on one line that shows as it is written."""
    text = " ".join(str(text).split())
    text = MARKUP.sub(lambda found: HTML.get(found[1], f"\\{found[1]}"), text)
    return ADDRESS.sub(lambda found: f"{found[1] or found[3]}&#{ord(found[2] or found[4])};", text)


def prose(text: str, table: bool = False) -> str:
    """The same, but what stands between backticks is code, with nothing in it changed."""
    parts = " ".join(str(text).split()).split("`")
    if len(parts) % 2 == 0:  # a backtick without its partner
        return literal(text)
    return "".join(_code(part, table) if i % 2 else _keep_blanks(part) for i, part in enumerate(parts))


def _code(text: str, table: bool) -> str:
    if table and "|" in text:  # readers differ on escaped bars in code, not on this
        return f"<code>{''.join(HTML.get(letter, letter) for letter in text)}</code>"
    return f"`{text}`"


def _keep_blanks(text: str) -> str:
    """A part of a text, with the blanks at its ends."""
    if not text.strip():
        return text
    return text[: len(text) - len(text.lstrip())] + literal(text) + text[len(text.rstrip()) :]
