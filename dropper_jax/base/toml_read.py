"""TOML texts as plain values; excessive nesting and excessively long numbers are rejected."""

from __future__ import annotations

import tomllib
from typing import Any

#: Maximum nesting depth of tables and lists; a farm needs 6.
DEEPEST = 32
#: Whole numbers have 64 bits in TOML.
LARGEST = 2**63


def parsed_toml(text: str) -> dict[str, Any]:
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
    _check_depth(found)
    return found


def _check_depth(table: dict[str, Any]) -> None:
    """Reject values that are nested too deeply, and whole numbers of more than 64 bits."""
    open_, depth = [table], 0
    while open_:
        depth += 1
        if depth > DEEPEST:
            raise tomllib.TOMLDecodeError(f"nested more than {DEEPEST} deep")
        inner = [v for item in open_ for v in (item.values() if isinstance(item, dict) else item)]
        for value in inner:
            if isinstance(value, int) and not -LARGEST <= value < LARGEST:
                raise tomllib.TOMLDecodeError("a whole number of more than 64 bits")
        open_ = [v for v in inner if isinstance(v, dict | list)]
