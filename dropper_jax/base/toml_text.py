"""Text formats: TOML of a scene, plain JSON values, Markdown as plain text, tables of notebooks."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import is_dataclass
from html import escape
from typing import Any, overload

from dropper_jax.base.read import Plain, Table, Values, plain

Json = None | bool | int | float | str | list["Json"] | dict[str, "Json"]
#: Version of the JSON object that commands print.
SCHEMA = 1


@overload
def jsonable(value: dict[str, Any]) -> dict[str, Any]: ...
@overload
def jsonable(value: Any) -> Json: ...
def jsonable(value: Any) -> Json:
    """Plain JSON values: arrays and tuples as lists, NaN and infinity as None, objects as `to_json` or their fields."""
    match value:
        case dict():
            return {str(key): jsonable(item) for key, item in value.items()}
        case list() | tuple():
            return [jsonable(item) for item in value]
        case _ if hasattr(value, "tolist"):
            return jsonable(value.tolist())
        case _ if hasattr(value, "to_json"):
            return jsonable(value.to_json())
        case _ if is_dataclass(value):
            return jsonable(vars(value))
        case float() if not math.isfinite(value):
            return None
    return value


def as_toml(table: Values) -> str:
    """Plain values (text, numbers, truth values, lists, tables) as TOML; None is omitted."""
    import tomlkit  # noqa: PLC0415 - 30 ms that only writing needs

    return tomlkit.dumps(_item(plain(table))).strip() + "\n"


def _item(value: Plain) -> Plain:
    """Values without None; the numbers and texts of a list that is too long for one line have a line each."""
    import tomlkit  # noqa: PLC0415

    if isinstance(value, Mapping):
        return {key: _item(item) for key, item in value.items() if item is not None}
    if not isinstance(value, list):
        return value
    items = [_item(item) for item in value]
    # maximum length of a list on one line [characters]; a longer list has one line per item
    if any(isinstance(item, Mapping) for item in items) or len(repr(items)) <= 100:
        return items
    return tomlkit.item(items).multiline(True)


#: Maximum nesting depth of tables and lists; a farm needs 6.
DEEPEST = 32


def parsed_toml(text: str) -> Table:
    """The tables of a TOML text.

    Raises:
        tomllib.TOMLDecodeError: the text is not TOML, or exceeds what a scene can contain.
    """
    try:
        found = tomllib.loads(text)
    except RecursionError:
        raise tomllib.TOMLDecodeError(f"nested more than {DEEPEST} deep") from None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError as error:  # a number with more digits than Python reads
        raise tomllib.TOMLDecodeError(str(error).split(";")[0]) from None
    _check_depth(found, 1)
    return found


def _check_depth(value: Plain, depth: int) -> None:
    """Reject values that are nested too deeply, and whole numbers of more than 64 bits."""
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise tomllib.TOMLDecodeError("a whole number of more than 64 bits")
    if isinstance(value, dict):
        value = [*value.values()]
    if isinstance(value, list):
        if depth > DEEPEST:
            raise tomllib.TOMLDecodeError(f"nested more than {DEEPEST} deep")
        for item in value:
            _check_depth(item, depth + 1)


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
    for i, part in enumerate(parts):
        if i % 2:
            parts[i] = _code(part, table)
        else:  # with its leading and trailing blanks
            parts[i] = re.sub(r"\S(.*\S)?", lambda found: literal(found[0]), part)
    return "".join(parts)


def _code(text: str, table: bool) -> str:
    if table and "|" in text:  # readers differ on escaped bars in code, but not on this form
        return f"<code>{''.join(HTML.get(letter, letter) for letter in text)}</code>"
    return f"`{text}`"


def html_table(title: str, rows: Iterable[tuple[str, ...]]) -> str:
    """A table with a title and rows of cells, the first of each a heading."""
    lines = []
    for head, *cells in rows:
        row = f"<th style='text-align:left'>{escape(head)}</th>"
        for cell in cells:
            row += f"<td style='text-align:left'>{escape(cell)}</td>"
        lines.append(f"<tr>{row}</tr>")
    return f"<table><caption>{escape(title)}</caption>{''.join(lines)}</table>"
