"""A scene from a name, a file or plain values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dropper_jax.base.files import references_of
from dropper_jax.load.packaged import find_scene, folder_of
from dropper_jax.load.scene import Scene


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
    with references_of(folder_of(source, allow_outside)):
        return Scene.from_dict(*find_scene(source))
