"""Names of free parameters: full paths, unique short names, or by default the scene's damping."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.effects import EFFECTS
from dropper_jax.load.scene import Scene
from dropper_jax.run.build import build
from fitting.parameters.parameter import paths

#: Damping fields by effect.
DAMPING = {
    "linear_damping": ("b_l",),
    "quadratic_damping": ("b_q",),
    "joint_friction": ("viscous", "dry"),
}


def default_free(scene: Scene) -> list[str]:
    """The parameters listed in the scene's `[fit] free`, otherwise every damping parameter that it has.

    Raises:
        SceneError: a scene without damping.
    """
    if scene.fit is not None and scene.fit.free:
        return full_names(scene, scene.fit.free, "fit.free")
    found = [
        f"effects.{name}.{key}"
        for name, keys in DAMPING.items()
        for key in keys
        if scene.effects.get(name, {}).get(key) is not None
    ]
    if not found:
        raise SceneError("free: the scene has no damping to fit. Use --free with paths such as b_l, b_q")
    return found


def full_names(scene: Scene, names: Sequence[str], option: str = "free") -> list[str]:
    """Full paths of names that may be short: `b_l`, `dry`, `dry.1` if only one field has this name.

    Error messages use `option` as their heading.
    """
    names = [name.strip() for name in names]
    known = None if all(_is_full(name) for name in names) else paths(build(scene)[0])
    return [name if _is_full(name) else _full(name, known, option) for name in names]


def _is_full(name: str) -> bool:
    known = ("camera.", "clock.", "marker.", "parameters.", "release.", "rig.")
    return name.count(".") >= 2 or name.startswith(known)


def _full(name: str, names: Sequence[str], option: str) -> str:
    if not name:
        raise SceneError(f"{option}: an empty name; allowed: names of parameters, separated by commas")
    stem, _, entry = name.partition(".")
    names = [p for p in names if not p.startswith("line.") or p.split(".")[1].isdecimal()]
    found = [p for p in names if p.rsplit(".", 1)[1] == stem]
    if not found:
        found = [
            f"effects.{effect}.{f.name}"
            for effect, cls in EFFECTS.items()
            for f in dataclasses.fields(cls)
            if f.name == stem and effect in DAMPING and f.name in DAMPING[effect]
        ]
    if len(found) != 1:
        short = sorted({p.rsplit(".", 1)[1] for p in names} | {key for keys in DAMPING.values() for key in keys})
        raise SceneError(f"{option}: {name!r} does not exist in the scene; {nearest(stem, short + names)}")
    return found[0] + (f".{entry}" if entry else "")
