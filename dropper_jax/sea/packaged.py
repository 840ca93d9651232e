"""Packaged seas: plain tables by name; needs no JAX."""

from __future__ import annotations

import tomllib
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Plain, read_text


def _folder() -> Traversable:
    return resources.files("dropper_jax") / "data" / "seas"


def sea_names() -> tuple[str, ...]:
    """Names of the packaged seas."""
    return tuple(sorted(item.name.removesuffix(".toml") for item in _folder().iterdir() if item.name.endswith(".toml")))


def read_packaged(name: Plain, path: str) -> dict[str, Any]:
    """The table of a packaged sea; a component file that it names lies beside it."""
    name, known = read_text(name, path), sea_names()
    if name not in known:
        raise SceneError(f"{path}: {name!r} is not a packaged sea; {nearest(name, known)}")
    table = tomllib.loads((_folder() / f"{name}.toml").read_text())
    table.pop("description")
    if "file" in table.get("waves", {}):
        table["waves"]["file"] = str(_folder() / table["waves"]["file"])
    return table
