"""A scene's plain values as TOML, so that a packaged or imported scene can be edited."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from dropper_jax.base.read import Plain, plain

#: Width of lists that are broken into lines.
WIDTH = 100


def as_toml(table: Mapping[str, Any]) -> str:
    """Plain values (text, numbers, truth values, lists, tables) as TOML; None is left out."""
    return "\n".join(_tables(dict(table), "")).strip() + "\n"


def _tables(table: Mapping[str, Any], path: str) -> list[str]:
    """Values of a table, then the tables inside it under their own heads."""
    values = {key: value for key, value in table.items() if value is not None and not _headed(value)}
    lines = [f"{_key(key)} = {_value(value)}" for key, value in values.items()]
    for key, value in table.items():
        if not _headed(value):
            continue
        head = f"{path}.{_key(key)}" if path else _key(key)
        if isinstance(value, Mapping):
            lines += ["", f"[{head}]", *_tables(value, head)]
        else:
            for item in value:
                lines += ["", f"[[{head}]]", *_tables(item, head)]
    return lines


def _headed(value: Plain) -> bool:
    """Whether a value stands under a head of its own: a table, or a list of tables that are more than a few words."""
    if isinstance(value, Mapping):
        return True
    return isinstance(value, list) and bool(value) and all(isinstance(item, Mapping) for item in value) and _long(value)


def _long(items: list[Any]) -> bool:
    return any(len(item) > 3 or any(isinstance(v, Mapping | list) for v in item.values()) for item in items)


def _key(key: str) -> str:
    bare = key and all(c.isascii() and (c.isalnum() or c in "-_") for c in key)
    return key if bare else json.dumps(key, ensure_ascii=False)


def _value(value: Plain) -> str:
    value = plain(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None) + " }"
    if isinstance(value, list):
        return _list([_value(item) for item in value])
    return repr(value)


def _list(items: list[str]) -> str:
    text = ", ".join(items)
    if len(text) <= WIDTH:
        return f"[{text}]"
    if all("{" in item or "[" in item for item in items):
        return "[\n" + "".join(f"    {item},\n" for item in items) + "]"
    lines = [""]
    for item in items:  # filled by items: a text may hold spaces
        if lines[-1] and len(lines[-1]) + len(item) > WIDTH:
            lines.append("")
        lines[-1] += f"{item}, "
    return "[\n" + "".join(f"    {line.rstrip()}\n" for line in lines) + "]"
