"""Packaged scenes as plain values; needs no JAX, so that listing them is quick."""

from __future__ import annotations

import re
import tomllib
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.toml_read import parsed_toml
from dropper_jax.load.farm import farm_table, is_farm
from dropper_jax.load.pitching import pitching

#: Effects that an undamped scene is without.
DAMPING = ("linear_damping", "quadratic_damping")
#: How fast the force of the thesis (E.1)-(E.3) rises [N/s], by release; (E.2) and (E.3) print the node of (E.1).
RAMPS = {"dropper-release-a": 0.094, "dropper-release-b": 0.065, "dropper-release-c": 0.065}
#: When it starts, and when the node is released [s].
RAMP = 3.0, 15.0
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
    variants = (name + suffix for suffix, (of, _) in VARIANTS.items() for name in files if of.fullmatch(name))
    return tuple(sorted((*files, *variants)))


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
    files = _files()
    if name in files:
        return parse_toml(files[name].read_bytes(), f"{name}.toml")
    file, make = next(
        (name.removesuffix(suffix), make) for suffix, (_, make) in VARIANTS.items() if name.endswith(suffix)
    )
    return make(parse_toml(files[file].read_bytes(), f"{file}.toml"), file)


def _variant(table: dict[str, Any], note: str, **sections: Any) -> dict[str, Any]:
    return {**table, "description": f"{table['description']} {note}", **sections}


def _undamped(table: dict[str, Any], file: str) -> dict[str, Any]:
    effects = {name: values for name, values in table["effects"].items() if name not in DAMPING}
    return _variant(table, "Without damping.", effects=effects)


def _table_6(table: dict[str, Any], file: str) -> dict[str, Any]:
    note = "It starts from the poses of Table 6: the buoy is held where they put it until the chain rests, then let go."
    return _variant(table, note, start={"kind": "points"})


def _ramp(table: dict[str, Any], file: str) -> dict[str, Any]:
    (begin, release), start = RAMP, table["start"]
    force, of = start["release_force"], "the packaged release, since the thesis gives none"
    if file in RAMPS:
        force, of = [[0.0, 0.0, RAMPS[file] * (release - begin)]], "thesis appendix E"
    ramp = {"nodes": start["release_nodes"], "force_n": force, "start": begin, "rise": release - begin}
    return _variant(
        table,
        f"As the thesis does it: from rest a force rises from {begin:g} s on to that of {of}, until {release:g} s.",
        run={"dt": 0.0065, "duration": 65.0},
        effects={**table["effects"], "nodal_force": {**ramp, "release": release}},
        start={"kind": "static"},
    )


def _relative(table: dict[str, Any], file: str) -> dict[str, Any]:
    force = {**table["effects"]["thesis_wave_force"], "velocity": "relative"}
    return _variant(
        table,
        "With the velocity relative to the nodes, thesis (6.13), which (C.22)-(C.24) drop.",
        run={**table["run"], "dt": 0.0025},
        effects={**table["effects"], "thesis_wave_force": force},
    )


#: Scenes made of packaged ones: what is appended to their names, which have it, and how the scene is changed.
VARIANTS = {
    "-undamped": (re.compile("dropper-release-.*"), _undamped),
    "-ramp": (re.compile("dropper-release-[a-e]"), _ramp),
    "-relative": (re.compile("dropper-north-sea-thesis"), _relative),
    "-table-6": (re.compile("paper-case-.*"), _table_6),
    "-pitching": (re.compile("paper-case-[1-3]"), lambda table, file: pitching(table)),
}
