"""TOML texts as plain values; tables within tables beyond measure and endless numbers are refused."""

from __future__ import annotations

import tomllib
from typing import Any

#: Tables and lists within each other; a farm needs 6.
DEEPEST = 32
#: Whole numbers have 64 bits in TOML.
LARGEST = 2**63


def parsed_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises:
        tomllib.TOMLDecodeError: no TOML, or more than a scene can be.
    """
    try:
        found = tomllib.loads(text)
    except RecursionError:
        raise tomllib.TOMLDecodeError(f"nested more than {DEEPEST} deep") from None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError as error:  # a number of more digits than Python reads
        raise tomllib.TOMLDecodeError(str(error).split(";")[0]) from None
    _check_depth(found)
    return found


def _check_depth(table: dict[str, Any]) -> None:
    """Refuse what is nested too deeply, and whole numbers of more than 64 bits."""
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
