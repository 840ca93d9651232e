"""Packaged scenes and scene files as plain tables; needs no JAX, so that listing them is quick."""

from __future__ import annotations

import tomllib
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.load.farm import farm_table

#: `NAME-undamped` is the packaged scene NAME without these effects, for the releases of the lab dropper.
DAMPING = ("linear_damping", "quadratic_damping")


UNDAMPED = "-undamped"


RELEASES = "dropper-release-"


def _folder() -> Traversable:
    return resources.files("dropper_jax") / "data" / "scenes"


def _parse(data: bytes, label: str) -> dict[str, Any]:
    try:
        return tomllib.loads(data.decode())
    except UnicodeDecodeError as error:
        raise SceneError(f"{label}: not a text file in UTF-8 (byte {error.start})") from None
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{label}: TOML syntax: {error}") from None


def _files() -> dict[str, Any]:
    found = {item.name.removesuffix(".toml"): item for item in _folder().iterdir() if item.name.endswith(".toml")}
    return dict(sorted(found.items()))


def packaged() -> dict[str, dict[str, Any]]:
    """All packaged scenes by name, the undamped ones included."""
    found = {}
    for name, item in _files().items():
        table = _parse(item.read_bytes(), item.name)
        found[name] = table
        if name.startswith(RELEASES):
            found[name + UNDAMPED] = _undamped(table)
    found["dropper-farm"] = farm_table("dropper-farm")
    return dict(sorted(found.items()))


def _undamped(table: dict[str, Any]) -> dict[str, Any]:
    effects = {name: values for name, values in table["effects"].items() if name not in DAMPING}
    return {**table, "description": table["description"] + " Without damping.", "effects": effects}


def scene_names() -> tuple[str, ...]:
    """Names of the packaged scenes."""
    return tuple(packaged())
