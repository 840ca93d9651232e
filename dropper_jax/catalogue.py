"""Packaged scenes and scene files as plain tables; needs no JAX, so that listing them is quick."""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from dropper_jax.errors import SceneError, nearest
from dropper_jax.farm import farm_table, is_farm
from dropper_jax.moordyn.sections import looks_like_moordyn

#: `NAME-undamped` is the packaged scene NAME without these effects, for the releases of the lab dropper.
DAMPING = ("linear_damping", "quadratic_damping")
UNDAMPED = "-undamped"
RELEASES = "dropper-release-"


def _folder() -> Any:
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
            from dropper_jax.moordyn.reader import read_moordyn

            return read_moordyn(path), path.stem
        return _parse(data, str(path)), path.stem
    except OSError as error:
        raise SceneError(f"scene: cannot read {str(path)!r}: {error.strerror or error}") from None
