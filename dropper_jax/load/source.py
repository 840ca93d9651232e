"""A scene from a name, a file or plain values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.references import references_of
from dropper_jax.load.named import find_scene
from dropper_jax.load.packaged import is_packaged
from dropper_jax.load.scene import Scene
from dropper_jax.moordyn.reading.reader import read_moordyn
from dropper_jax.moordyn.reading.yaml_mooring import SUFFIXES, read_yaml_mooring


def load_scene(source: str | Path | Mapping[str, Any] | Scene, *, allow_outside: bool = False) -> Scene:
    """A scene from a packaged name, a TOML file, a MoorDyn input (told by its header of line types), a mooring of
    MoorPy or RAFT (.yaml) or plain values.

    Args:
        allow_outside: a file may name files that are neither below its folder nor below the working folder.

    Raises:
        SceneError: for a file that is missing or no TOML, an unknown name (with the nearest), or any bad value.
    """
    if isinstance(source, Scene):
        return source
    if isinstance(source, Mapping):
        return Scene.from_dict(source)
    found, name = find_scene(source)
    with references_of(folder_of(source, allow_outside)):
        return Scene.from_dict(plain_values(found), name)


def folder_of(source: str | Path, allow_outside: bool) -> Path | None:
    """The folder below which the files that a scene names must be; None: anywhere, as for packaged scenes."""
    if allow_outside or (isinstance(source, str) and is_packaged(source)):
        return None
    return Path(source).parent


def plain_values(found: dict[str, Any] | Path, depth: float | None = None) -> dict[str, Any]:
    """Plain values of what `find_scene` found, a MoorDyn input read.

    Args:
        depth: of the water [m], for a MoorDyn input that has none.

    Raises:
        SceneError: a depth for anything else.
    """
    if isinstance(found, Path):
        read = read_yaml_mooring if found.suffix.lower() in SUFFIXES else read_moordyn
        return read(found, depth)
    if depth is not None:
        raise SceneError("--depth: is for MoorDyn inputs without WtrDpth; allowed: --set sea.depth=... for scenes")
    return found
