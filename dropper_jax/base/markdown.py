"""Users' names and texts in Markdown, shown unchanged: no markup, no links, no HTML."""

from __future__ import annotations

import re

#: Characters that Markdown or HTML would interpret as markup inside a line; `_` and `-` inside words are not markup.
MARKUP = re.compile(r"([\\\\`*\[\]<>&#!~|]|(?<!\w)_|_(?!\w))")
HTML = {"<": "&lt;", ">": "&gt;", "&": "&amp;", "|": "&#124;"}
#: Text that a reader would turn into a link automatically.
ADDRESS = re.compile(r"(?i)\b(https?|ftp|mailto|javascript|file|data)(:)|\b(www)(\.)")


def literal(text: str) -> str:
    """A text on one line that is displayed exactly as written."""
    text = " ".join(str(text).split())
    text = MARKUP.sub(lambda found: HTML.get(found[1], f"\\{found[1]}"), text)
    return ADDRESS.sub(lambda found: f"{found[1] or found[3]}&#{ord(found[2] or found[4])};", text)


def prose(text: str, table: bool = False) -> str:
    """The same, but text between backticks is code and is left unchanged."""
    parts = " ".join(str(text).split()).split("`")
    if len(parts) % 2 == 0:  # a backtick without its partner
        return literal(text)
    return "".join(_code(part, table) if i % 2 else _keep_blanks(part) for i, part in enumerate(parts))


def _code(text: str, table: bool) -> str:
    if table and "|" in text:  # readers differ on escaped bars in code, but not on this form
        return f"<code>{''.join(HTML.get(letter, letter) for letter in text)}</code>"
    return f"`{text}`"


def _keep_blanks(text: str) -> str:
    """Part of a text, with its leading and trailing blanks."""
    if not text.strip():
        return text
    return text[: len(text) - len(text.lstrip())] + literal(text) + text[len(text.rstrip()) :]
