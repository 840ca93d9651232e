"""TOML text: writing plain values, reading with limits."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping

from dropper_jax.base.read import Plain, Table, Values, plain

#: Maximum length of a list on one line [characters]; a longer one has one item per line.
LINE_LENGTH = 100


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
    has_tables = any(isinstance(item, Mapping) for item in items)
    fits_one_line = len(repr(items)) <= LINE_LENGTH
    if has_tables or fits_one_line:
        return items
    return tomlkit.item(items).multiline(True)


#: Maximum nesting depth of tables and lists; a farm needs 6.
MAX_DEPTH = 32


def parse_toml_text(text: str) -> Table:
    """The tables of a TOML text.

    Raises:
        tomllib.TOMLDecodeError: the text is not TOML, or exceeds what a scene can contain.
    """
    try:
        tables = tomllib.loads(text)
    except RecursionError:
        raise tomllib.TOMLDecodeError(f"nested more than {MAX_DEPTH} deep") from None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError as error:  # a number with more digits than Python reads
        raise tomllib.TOMLDecodeError(str(error).split(";")[0]) from None
    _check_depth(tables, 1)
    return tables


def _check_depth(value: Plain, depth: int) -> None:
    """Reject values that are nested too deeply, and whole numbers of more than 64 bits."""
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise tomllib.TOMLDecodeError("a whole number of more than 64 bits")
    if isinstance(value, dict):
        value = [*value.values()]
    if isinstance(value, list):
        if depth > MAX_DEPTH:
            raise tomllib.TOMLDecodeError(f"nested more than {MAX_DEPTH} deep")
        for item in value:
            _check_depth(item, depth + 1)
