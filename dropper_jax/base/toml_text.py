"""A scene's plain values as TOML, so that a packaged or imported scene can be edited."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dropper_jax.base.read import Plain, plain

#: Maximum length of a list on one line [characters]; a longer list has one line per item.
WIDTH = 100


def as_toml(table: Mapping[str, Any]) -> str:
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
    if any(isinstance(item, Mapping) for item in items) or len(repr(items)) <= WIDTH:
        return items
    return tomlkit.item(items).multiline(True)
