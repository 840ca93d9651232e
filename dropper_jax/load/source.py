"""A scene from a name, a file or plain values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import references_of
from dropper_jax.load.packaged import find_scene, is_packaged
from dropper_jax.load.scene import Scene
from dropper_jax.moordyn.reading.reader import read_moordyn
from dropper_jax.moordyn.reading.yaml_mooring import SUFFIXES, read_yaml_mooring


def load_scene(source: str | Path | Mapping[str, Any] | Scene, *, allow_outside: bool = False) -> Scene:
    """A scene from a packaged name, a TOML file, a MoorDyn input, a mooring of MoorPy or RAFT (.yaml), or plain values.

    A MoorDyn input is recognised by its header of line types.

    Args:
        allow_outside: a file may refer to files that are neither below its folder nor below the working folder.

    Raises:
        SceneError: a file that is missing or not TOML, an unknown name (with the nearest), or any invalid value.
    """
    if isinstance(source, Scene):
        return source
    if isinstance(source, Mapping):
        return Scene.from_dict(source)
    found, name = find_scene(source)
    with references_of(folder_of(source, allow_outside)):
        return Scene.from_dict(plain_values(found), name)


def folder_of(source: str | Path, allow_outside: bool) -> Path | None:
    """The folder that must contain the files to which a scene refers; None: any folder, as for packaged scenes."""
    if allow_outside or (isinstance(source, str) and is_packaged(source)):
        return None
    return Path(source).parent


def plain_values(found: dict[str, Any] | Path, depth: float | None = None) -> dict[str, Any]:
    """Plain values of the result of `find_scene`; reads a MoorDyn input.

    Args:
        depth: depth of the water [m], for a MoorDyn input without one.

    Raises:
        SceneError: a depth for any other source.
    """
    if isinstance(found, Path):
        read = read_yaml_mooring if found.suffix.lower() in SUFFIXES else read_moordyn
        return read(found, depth)
    if depth is not None:
        raise SceneError("--depth: is only for MoorDyn inputs without WtrDpth. Use --set sea.depth=... for scenes")
    return found
