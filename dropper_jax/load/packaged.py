"""Packaged scenes as plain values; needs no JAX, so that listing them is quick."""

from __future__ import annotations

import tomllib
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.toml_read import parsed_toml
from dropper_jax.load.farm import farm_table, is_farm
from dropper_jax.load.pitching import pitching

#: `NAME-undamped` is the packaged scene NAME without these effects, for the releases of the lab dropper.
DAMPING = ("linear_damping", "quadratic_damping")
UNDAMPED = "-undamped"
RELEASES = "dropper-release-"
#: `NAME-table-6` is the paper's case NAME from the poses of the paper's Table 6, whose run in is part of its Table 7.
CASES, TABLE_6 = "paper-case-", "-table-6"
#: `NAME-pitching` is one of these with its spar free to pitch.
PITCHING, PITCHES = "-pitching", ("paper-case-1", "paper-case-2", "paper-case-3")
#: Farms of other sizes are packaged too, but not listed.
FARM = "dropper-farm"


def parse_toml(data: bytes, label: str) -> dict[str, Any]:
    """Plain values of a TOML file.

    Raises:
        SceneError: no UTF-8, a syntax error (with the line number), tables within tables beyond measure.
    """
    try:
        return parsed_toml(data.decode())
    except UnicodeDecodeError as error:
        raise SceneError(f"{label}: not a text file in UTF-8 (byte {error.start})") from None
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{label}: TOML syntax: {error}") from None


def _files() -> dict[str, Traversable]:
    folder = resources.files("dropper_jax") / "data" / "scenes"
    return {item.name.removesuffix(".toml"): item for item in folder.iterdir() if item.name.endswith(".toml")}


def scene_names() -> tuple[str, ...]:
    """Names of the packaged scenes."""
    files = _files()
    undamped = (name + UNDAMPED for name in files if name.startswith(RELEASES))
    placed = (name + TABLE_6 for name in files if name.startswith(CASES))
    return tuple(sorted((*files, *undamped, *placed, *(name + PITCHING for name in PITCHES))))


def is_packaged(name: str) -> bool:
    """Whether a packaged scene has this name, farms of any size included."""
    return is_farm(name) or name in scene_names()


def packaged_scene(name: str) -> dict[str, Any]:
    """Plain values of a packaged scene.

    Raises:
        SceneError: a farm of a size that there is not.
        KeyError: not `is_packaged`.
    """
    if is_farm(name):
        return farm_table(name, parse_toml(_files()[FARM].read_bytes(), f"{FARM}.toml"))
    file = name.removesuffix(UNDAMPED).removesuffix(TABLE_6).removesuffix(PITCHING)
    table = parse_toml(_files()[file].read_bytes(), f"{file}.toml")
    if name == file:
        return table
    if name.endswith(PITCHING):
        return pitching(table)
    return _undamped(table) if name.endswith(UNDAMPED) else _placed(table)


def _undamped(table: dict[str, Any]) -> dict[str, Any]:
    effects = {name: values for name, values in table["effects"].items() if name not in DAMPING}
    return {**table, "description": table["description"] + " Without damping.", "effects": effects}


def _placed(table: dict[str, Any]) -> dict[str, Any]:
    told = (
        " It starts from the poses of Table 6: the buoy is held where they put it until the chain rests, then let go."
    )
    return {**table, "description": table["description"] + told, "start": {"kind": "points"}}
