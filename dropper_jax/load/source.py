"""A scene from a name, a file or plain values."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.load.farm import farm_table, is_farm
from dropper_jax.load.packaged import _parse, packaged
from dropper_jax.load.scene import Scene
from dropper_jax.moordyn.reading.reader import read_moordyn
from dropper_jax.moordyn.reading.sections import looks_like_moordyn


def load_scene(source: str | Path | Mapping[str, Any] | Scene) -> Scene:
    """A scene from a packaged name, a TOML file or plain values.

    Raises:
        SceneError: for a file that is missing or no TOML, an unknown name (with the nearest), or any bad value.
    """
    if isinstance(source, Scene):
        return source
    if isinstance(source, Mapping):
        return Scene.from_dict(source)
    table, name = read_toml(source)
    return Scene.from_dict(table, name)


def read_toml(source: str | Path) -> tuple[dict[str, Any], str]:
    """Plain values and name of a packaged scene, a TOML file or a MoorDyn input (told by its header of line types).

    Raises:
        SceneError: unknown name (with the nearest), missing file, or a syntax error (with the line number).
    """
    known = packaged()
    if isinstance(source, str) and source in known:
        return known[source], source
    if isinstance(source, str) and is_farm(source):
        return farm_table(source), source
    path = Path(source)
    looks_like_file = path.suffix or len(path.parts) > 1 or path.exists()
    if not looks_like_file:
        raise SceneError(f"scene: {str(source)!r} is not a packaged scene; {nearest(str(source), known)}")
    try:
        data = path.read_bytes()
        if path.suffix.lower() != ".toml" and looks_like_moordyn(data.decode(errors="replace")):
            return read_moordyn(path), path.stem
        return _parse(data, str(path)), path.stem
    except OSError as error:
        raise SceneError(f"scene: cannot read {str(path)!r}: {error.strerror or error}") from None
