"""Scenes from a name or a file as plain values; needs no JAX, so that listing packaged scenes is quick."""

from __future__ import annotations

import os
import re
import tomllib
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.files import refuse_pipe
from dropper_jax.base.read import Table
from dropper_jax.base.toml_text import parse_toml_text
from dropper_jax.decks.reading.sections import looks_like_moordyn
from dropper_jax.load.variants import VARIANTS

#: Farms of other sizes are packaged too, but not listed. Digits beyond those of any count are no size.
FARM = "dropper-farm"
FARM_NAME = re.compile(r"dropper-farm(?:-(\d{1,9}))?")
MAX_DROPPERS = 200
#: Longest name of a file on common systems; no packaged scene has a longer one.
LONGEST_NAME = 255


def parse_toml(data: bytes, label: str) -> Table:
    """Plain values of a TOML file.

    Raises:
        SceneError: not UTF-8, a syntax error (with the line number), or excessively nested tables.
    """
    try:
        return parse_toml_text(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise SceneError(f"{label}: not a text file in UTF-8 (byte {error.start})") from None
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{label}: TOML syntax: {error}") from None


def _files() -> dict[str, Traversable]:
    folder = resources.files("dropper_jax") / "data" / "scenes"
    return {item.name.removesuffix(".toml"): item for item in folder.iterdir() if item.name.endswith(".toml")}


def scene_names() -> tuple[str, ...]:
    """Names of the packaged scenes."""
    return tuple(sorted(name + suffix for name in _files() for suffix in ("", *variants_of(name))))


def scene_titles() -> dict[str, dict[str, str]]:
    """Titles of the packaged scenes by group; names of variants are not listed (see `variants_of`)."""
    file = resources.files("dropper_jax") / "data" / "scene_titles.toml"
    return parse_toml(file.read_bytes(), "scene_titles.toml")


def variants_of(name: str) -> list[str]:
    """Suffixes of the scenes derived from a packaged one."""
    return [suffix for suffix, (of, _) in VARIANTS.items() if of.fullmatch(name)]


def is_packaged(name: str) -> bool:
    """Whether a packaged scene has this name, including farms of any size."""
    return FARM_NAME.fullmatch(name) is not None or name in scene_names()


def packaged_scene(name: str) -> Table:
    """Plain values of a packaged scene.

    Raises:
        SceneError: a farm size that does not exist.
        KeyError: not `is_packaged`.
    """
    if not is_packaged(name):
        raise KeyError(name)
    if farm := FARM_NAME.fullmatch(name):
        return _farm_table(name, farm[1])
    if name in _files():
        return _read_packaged(name)
    suffix = next(suffix for suffix in VARIANTS if name.endswith(suffix))
    file = name.removesuffix(suffix)
    return VARIANTS[suffix][1](_read_packaged(file), file)


def _read_packaged(name: str) -> Table:
    return parse_toml(_files()[name].read_bytes(), f"{name}.toml")


def _farm_table(name: str, digits: str | None) -> Table:
    """Plain values of `dropper-farm-K` from those of `dropper-farm`; `digits` are K.

    Raises:
        SceneError: K out of range.
    """
    table = _read_packaged(FARM)
    if digits is None:
        return table
    droppers = int(digits)
    if not 1 <= droppers <= MAX_DROPPERS:
        raise SceneError(
            f"scene: {name!r} has {droppers} droppers; allowed: dropper-farm-1 to dropper-farm-{MAX_DROPPERS}"
        )
    return {**table, "name": name, "parameters": {**table["parameters"], "droppers": droppers}}


def find_scene(source: str | Path, depth: float | None = None) -> tuple[Table, str]:
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


def _read_mooring(path: Path, depth: float | None) -> Table:
    from dropper_jax.decks.reading.reader import read_moordyn  # noqa: PLC0415 - 0.5 s that starting does not need
    from dropper_jax.decks.reading.yaml_mooring import SUFFIXES, read_yaml_mooring  # noqa: PLC0415

    if path.suffix.lower() in SUFFIXES:
        return read_yaml_mooring(path, depth)
    return read_moordyn(path, depth)


def _read_file(path: Path) -> bytes:
    name = str(path)
    looks_like_a_file = path.suffix or len(path.parts) > 1 or len(name) > LONGEST_NAME or os.path.exists(path)
    if not looks_like_a_file:
        raise SceneError(f"scene: {name!r} is not a packaged scene; {nearest(name, scene_names())}")
    refuse_pipe(path, "scene")
    try:
        return path.read_bytes()
    except (OSError, ValueError) as error:  # a name that no file can have is a ValueError
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"scene: cannot read {name!r}: {reason}; `dropper new` writes a scene to edit") from None


def folder_of(source: str | Path, allow_outside: bool) -> Path | None:
    """The folder that must contain the files to which a scene refers; None: any folder, as for packaged scenes."""
    if allow_outside or (isinstance(source, str) and is_packaged(source)):
        return None
    return Path(source).parent
