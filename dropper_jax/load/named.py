"""A scene's plain values by name or file; needs no JAX, so that a typing error is reported at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.files import refuse_pipe
from dropper_jax.load.packaged import is_packaged, packaged_scene, parse_toml, scene_names
from dropper_jax.moordyn.reading.sections import looks_like_moordyn


def find_scene(source: str | Path) -> tuple[dict[str, Any] | Path, str]:
    """Plain values and name of a packaged scene or a TOML file; for MoorDyn or YAML, path and name, not yet read.

    Raises:
        SceneError: unknown name (with the nearest), missing file, or a syntax error (with the line number).
    """
    if isinstance(source, str) and is_packaged(source):
        return packaged_scene(source), source
    path = Path(source)
    looks_like_file = path.suffix or len(path.parts) > 1 or path.exists()
    if not looks_like_file:
        raise SceneError(f"scene: {str(source)!r} is not a packaged scene; {nearest(str(source), scene_names())}")
    refuse_pipe(path, "scene")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f"scene: cannot read {str(path)!r}: {error.strerror or error}") from None
    if path.suffix.lower() in (".yaml", ".yml"):
        return path, path.stem
    if path.suffix.lower() != ".toml" and looks_like_moordyn(data.decode(errors="replace")):
        return path, path.stem
    return parse_toml(data, str(path)), path.stem
