"""Names of free parameters: full paths, unique short names, or by default the scene's damping."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import ScenePath
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.build import build_model
from fitting.parameters.parameter import Bounds, Priors, StartValues, given_effect
from fitting.parameters.paths import paths
from fitting.parameters.targets import CAMERA, SCALE

#: Damping fields by effect.
DAMPING = {
    "linear_damping": ("b_l",),
    "quadratic_damping": ("b_q",),
    "joint_friction": ("viscous", "dry"),
}
#: Paths of them.
DAMPING_PATHS = tuple(f"effects.{effect}.{key}" for effect, keys in DAMPING.items() for key in keys)


def default_free(scene: Scene) -> list[str]:
    """The parameters listed in the scene's `[fit] free`, otherwise every damping parameter that it has.

    Raises:
        SceneError: a scene without damping.
    """
    if scene.fit is not None and scene.fit.free:
        return full_names(scene, scene.fit.free, "fit.free")
    found = [path for path in DAMPING_PATHS if given_effect(scene, path) is not None]
    if not found:
        raise SceneError("free: the scene has no damping to fit. Use --free with paths such as b_l, b_q")
    return found


def default_rig(scene: Scene) -> list[str]:
    """Parameters that are uncertain after a rig is measured and mounted by hand: a factor of all lengths, and the zero
    of the angles. None if `[fit]` lists what is free, or without weight, which shows the lengths.
    """
    if (scene.fit is not None and scene.fit.free) or "weight" not in scene.effects:
        return []
    return [SCALE, CAMERA]


def full_names(scene: Scene, names: Sequence[str], option: str = "free") -> list[str]:
    """Full paths of names that may be short: `b_l`, `dry`, `dry.1` if only one field has this name.

    Error messages use `option` as their heading.
    """
    names = [name.strip() for name in names]
    known: list[str] = []
    if not all(map(_is_full, names)):
        known = [*paths(build_model(scene)), *scene.parameter_paths]
    return [_full_name(name, known, option) for name in names]


def free_option(names: Sequence[str], more: Sequence[str]) -> str:
    """The option that frees parameters of these names and the paths `more`."""
    fields = {ScenePath(path).key for path in DAMPING_PATHS}
    short = []
    for name in names:
        key = ScenePath(name).key
        if key in fields:
            name = key
        short.append(name)
    return f"--free {','.join(dict.fromkeys([*short, *more]))}"


class Changes(NamedTuple):
    """Start values, bounds and priors by full paths."""

    start: dict[str, float]
    bounds: dict[str, tuple[float | None, float | None]]
    priors: dict[str, tuple[float, float]]


def by_full_path(
    scene: Scene, start: StartValues | None, bounds: Bounds | None, priors: Priors | None, of_data: Sequence[str]
) -> Changes:
    """Start values, bounds and priors by full paths; names of the sections `of_data` are full already."""

    def full(option: str, name: str) -> str:
        if ScenePath(name).section in of_data:
            return name
        return full_names(scene, [name], option)[0]

    return Changes(
        {full("start", name): value for name, value in (start or {}).items()},
        {full("bounds", name): ends for name, ends in (bounds or {}).items()},
        {full("prior", name): prior for name, prior in (priors or {}).items()},
    )


def _is_full(name: str) -> bool:
    """Whether a name is a whole path."""
    sections = ("camera", "clock", "marker", "parameters", "release", "rig", "sea")
    return name.count(".") >= 2 or (ScenePath(name).section in sections and "." in name)


def _full_name(name: str, names: Sequence[str], option: str) -> str:
    """The one path among `names` that a name stands for; a full one stays."""
    if _is_full(name):
        return name
    if not name:
        raise SceneError(f"{option}: an empty name; allowed: names of parameters, separated by commas")
    stem, _, entry = name.partition(".")
    names = [p for p in names if not p.startswith("line.") or p.split(".")[1].isdecimal()]
    own = [p for p in names if ScenePath(p).section != "parameters"]
    found: list[str] = []
    for group in (own, DAMPING_PATHS, names):
        found = [p for p in group if ScenePath(p).key == stem]
        if found:
            break
    if len(found) != 1:
        short = sorted({ScenePath(p).key for p in [*names, *DAMPING_PATHS]})
        raise SceneError(f"{option}: {name!r} does not exist in the scene; {nearest(stem, short + names)}")
    if entry:
        return f"{found[0]}.{entry}"
    return found[0]
