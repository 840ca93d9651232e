"""Scenes from a name or a file as plain values; needs no JAX, so that listing packaged scenes is quick."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from functools import partial
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.files import refuse_pipe
from dropper_jax.base.toml_text import parsed_toml
from dropper_jax.decks.reading.sections import looks_like_moordyn

#: Effects that an undamped scene lacks.
DAMPING = ("linear_damping", "quadratic_damping")
#: Rate at which the force of thesis (E.1)-(E.3) rises [N/s], by release; (E.2) and (E.3) print the node of (E.1).
RAMPS = {"dropper-release-a": 0.094, "dropper-release-b": 0.065, "dropper-release-c": 0.065}
#: Start of the force [s], and releases of the node [s] by suffix. The thesis does not give the release: 15 s is that of
#: its Figure 5.3; at 14.1 s the angles of its model (Tables E.2 to E.4) are met best.
RAMP_START = 3.0
RELEASES = {"-ramp": 15.0, "-ramp-14": 14.1}
#: Farms of other sizes are packaged too, but not listed.
FARM = "dropper-farm"
FARM_NAME = re.compile(r"dropper-farm(?:-(\d+))?")
MOST_DROPPERS = 200
#: Centre of gravity of a pitching spar above its base [m], which the paper does not give: a homogeneous spar of its
#: size capsizes.
CENTRE = 1.0


def parse_toml(data: bytes, label: str) -> dict[str, Any]:
    """Plain values of a TOML file.

    Raises:
        SceneError: not UTF-8, a syntax error (with the line number), or excessively nested tables.
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
    variants = (name + suffix for name in files for suffix in variants_of(name))
    return tuple(sorted((*files, *variants)))


def scene_titles() -> dict[str, dict[str, str]]:
    """Titles of the packaged scenes by group; names of variants are not listed (see `variants_of`)."""
    file = resources.files("dropper_jax") / "data" / "scene_titles.toml"
    return parse_toml(file.read_bytes(), "scene_titles.toml")


def variants_of(name: str) -> list[str]:
    """Suffixes of the scenes derived from a packaged one."""
    return [suffix for suffix, (of, _) in VARIANTS.items() if of.fullmatch(name)]


def is_packaged(name: str) -> bool:
    """Whether a packaged scene has this name, including farms of any size."""
    return is_farm(name) or name in scene_names()


def packaged_scene(name: str) -> dict[str, Any]:
    """Plain values of a packaged scene.

    Raises:
        SceneError: a farm size that does not exist.
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


def _without_damping(table: dict[str, Any], file: str) -> dict[str, Any]:
    effects = {name: values for name, values in table["effects"].items() if name not in DAMPING}
    return _variant(table, "Without damping.", effects=effects)


def _table_6(table: dict[str, Any], file: str) -> dict[str, Any]:
    note = (
        "It starts from the configurations of Table 6: the buoy is held at that position until the chain settles, "
        "then released."
    )
    return _variant(table, note, start={"kind": "points"})


def _ramp(table: dict[str, Any], file: str, release: float) -> dict[str, Any]:
    begin = RAMP_START
    start = table["start"]
    force = start["release_force"]
    of = "the packaged release, because the thesis gives none"
    if file in RAMPS:
        force = [[0.0, 0.0, RAMPS[file] * (release - begin)]]
        of = "thesis appendix E"
    ramp = {"nodes": start["release_nodes"], "force_n": force, "start": begin, "rise": release - begin}
    return _variant(
        table,
        f"As in the thesis: starting from rest, a force rises from {begin:g} s to that of {of}, until {release:g} s.",
        run={"accuracy": 0.01, "save_interval": 0.02, "source_dt": 0.0065, "duration": 65.0},
        effects={**table["effects"], "nodal_force": {**ramp, "release": release}},
        start={"kind": "static"},
    )


def _relative(table: dict[str, Any], file: str) -> dict[str, Any]:
    force = {**table["effects"]["thesis_wave_force"], "velocity": "relative"}
    return _variant(
        table,
        "With the velocity relative to the nodes, thesis (6.13), which (C.22)-(C.24) omit.",
        run={**table["run"], "source_dt": 0.0025},
        effects={**table["effects"], "thesis_wave_force": force},
    )


#: Scenes derived from packaged ones: the suffix of their names, which scenes have it, and how the scene is changed.
VARIANTS = {
    "-undamped": (re.compile("dropper-release-.*"), _without_damping),
    "-ramp": (re.compile("dropper-release-[a-e]"), partial(_ramp, release=RELEASES["-ramp"])),
    "-ramp-14": (re.compile("dropper-release-[a-c]"), partial(_ramp, release=RELEASES["-ramp-14"])),
    "-relative": (re.compile("dropper-north-sea-thesis"), _relative),
    "-table-6": (re.compile("paper-case-.*"), _table_6),
    "-pitching": (re.compile("paper-case-[1-3]"), lambda table, file: pitching(table)),
}


def is_farm(name: str) -> bool:
    """Whether a scene name is that of a farm, `dropper-farm` or `dropper-farm-K`."""
    return FARM_NAME.fullmatch(name) is not None


def farm_table(name: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """Plain values of `dropper-farm-K` from those of `dropper-farm`.

    Raises:
        SceneError: K out of range.
    """
    digits = FARM_NAME.fullmatch(name).group(1)
    if digits is None:
        return dict(table)
    droppers = int(digits)
    if not 1 <= droppers <= MOST_DROPPERS:
        raise SceneError(
            f"scene: {name!r} has {droppers} droppers; allowed: dropper-farm-1 to dropper-farm-{MOST_DROPPERS}"
        )
    return {**table, "name": name, "parameters": {**table["parameters"], "droppers": droppers}}


def pitching(table: dict[str, Any]) -> dict[str, Any]:
    """The scene with each `[[buoy]]` as a `[[body]]`, with its line at the same position.

    Hull and ballast, `m_h H/2 + m_b z_b = m z_G`, give the moments of inertia:
    `m_h (H^2/12 + (H/2 - z_G)^2) + m_b (z_G - z_b)^2` across, `m D^2/8` about the axis.
    """
    positions = {point["name"]: point["position"] for point in table["point"]}
    bodies = [_body(buoy, positions[buoy["point"]]) for buoy in table["buoy"]]
    outcome = {buoy["point"] for buoy in table["buoy"]}
    note = (
        f" The spar pitches: a rigid body with its centre of gravity {CENTRE:g} m above the base, which the paper does "
        "not give (assumed)."
    )
    rest = {key: value for key, value in table.items() if key != "buoy"}
    points = [point for point in table["point"] if point["name"] not in outcome]
    return {**rest, "description": table["description"] + note, "point": points, "body": bodies}


def _body(buoy: dict[str, Any], point: list[float]) -> dict[str, Any]:
    ballast = 0.25  # height of the ballast above the base [m]; the hull's mass is spread over its height
    mass = buoy["mass"]
    height = buoy["height"]
    diameter = buoy["diameter"]
    hull = mass * (CENTRE - ballast) / (0.5 * height - ballast)
    across = hull * (height**2 / 12.0 + (0.5 * height - CENTRE) ** 2) + (mass - hull) * (CENTRE - ballast) ** 2
    attachment = buoy.get("attachment", 0.0)
    # number of slices of a spar
    cylinder = {
        "from": [0.0, 0.0, 0.0],
        "to": [0.0, 0.0, height],
        "diameter": diameter,
        "slices": 12,
        "ends": "from",
        **{key: buoy[key] for key in ("cdn", "cdt", "can", "cat") if key in buoy},
    }
    return {
        "name": buoy["name"],
        "position": [point[0], point[1], point[2] - attachment],
        "mass": mass,
        "centre_of_mass": [0.0, 0.0, CENTRE],
        "inertia": [across, across, mass * diameter**2 / 8.0],
        "cylinders": [cylinder],
        "attachments": {buoy["point"]: [0.0, 0.0, attachment]},
    }


def find_scene(source: str | Path, depth: float | None = None) -> tuple[dict[str, Any], str]:
    """Plain values and name of a packaged scene, a TOML file, a MoorDyn input or a YAML mooring.

    Args:
        depth: depth of the water [m], for a MoorDyn input without one.

    Raises:
        SceneError: unknown name (with the nearest), missing file, a syntax error (with the line number), or a depth for
            any other source.
    """
    if isinstance(source, str) and is_packaged(source):
        found = packaged_scene(source), source
    else:
        path = Path(source)
        data = _read_file(path)
        kind = path.suffix.lower()
        if kind in (".yaml", ".yml") or (kind != ".toml" and looks_like_moordyn(data.decode(errors="replace"))):
            return _read_mooring(path, depth), path.stem
        found = parse_toml(data, str(path)), path.stem
    if depth is not None:
        raise SceneError("--depth: is only for MoorDyn inputs without WtrDpth. Use --set sea.depth=... for scenes")
    return found


def _read_mooring(path: Path, depth: float | None) -> dict[str, Any]:
    from dropper_jax.decks.reading.reader import read_moordyn  # noqa: PLC0415 - 0.5 s that starting does not need
    from dropper_jax.decks.reading.yaml_mooring import SUFFIXES, read_yaml_mooring  # noqa: PLC0415

    return (read_yaml_mooring if path.suffix.lower() in SUFFIXES else read_moordyn)(path, depth)


def _read_file(path: Path) -> bytes:
    if not (path.suffix or len(path.parts) > 1 or path.exists()):  # it does not look like a file
        raise SceneError(f"scene: {str(path)!r} is not a packaged scene; {nearest(str(path), scene_names())}")
    refuse_pipe(path, "scene")
    try:
        return path.read_bytes()
    except OSError as error:
        raise SceneError(
            f"scene: cannot read {str(path)!r}: {error.strerror or error}; `dropper new` writes a scene to edit"
        ) from None


def folder_of(source: str | Path, allow_outside: bool) -> Path | None:
    """The folder that must contain the files to which a scene refers; None: any folder, as for packaged scenes."""
    if allow_outside or (isinstance(source, str) and is_packaged(source)):
        return None
    return Path(source).parent
