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
