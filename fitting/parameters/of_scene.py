"""Parameters that are numbers of the scene, not of the model: the length of a whole line, EA of a line type, a buoy.

Such a number changes many numbers of the model at once (the length of a line its links' lengths, masses and internal
damping). Their derivatives are found by differences on the host, once; in the compiled program the model changes along
that direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import ScenePath
from dropper_jax.load.paths import describe, locate_written
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.run.build import build_model, model_slopes
from fitting.parameters.parameter import Parameter, check_once, paths, resolve
from fitting.parameters.target import Direction, ModelPlace

#: A model that this change moves linearly to within `LINEAR_TOLERANCE` counts as linear in the number.
LINEAR_REACH, LINEAR_TOLERANCE = 0.2, 1e-9


def find_parameters(scene: Scene, model: Model, names: Sequence[str], option: str) -> tuple[Parameter, ...]:
    """The parameters of these paths: numbers of the model, otherwise of the scene.

    If lines are specified by the metre, paths have the same meaning as in the file: `line.leg.length` is the whole
    line.

    Raises:
        SceneError: a path that is neither.
    """
    found: list[Parameter] = []
    written = locate_written(scene.as_written())
    for name in names:
        if name in written or ScenePath(name).section == "parameters":
            found.append(scene_parameter(scene, model, name))
            continue
        try:
            found += resolve(model, [name], option=option)
        except SceneError as error:
            try:
                found.append(scene_parameter(scene, model, name))
            except SceneError:
                raise error from None
    check_once([p.name for p in found], option)
    return tuple(found)


def scene_parameter(scene: Scene, model: Model, path: str) -> Parameter:
    """The number of the scene at a path, and its effect on the model.

    Raises:
        SceneError: no such path, not a number, a number without effect on the model, or one that changes its shape.
    """
    slopes = model_slopes(scene, model, path)
    value: Any = scene.value(path)
    shift = LINEAR_REACH * (abs(value) or 1.0)
    here, there = (
        [np.asarray(leaf) for leaf in jax.tree.leaves(build_model(scene.with_values({path: at})))]
        for at in (value, value + shift)
    )
    linear = all(
        np.allclose(
            here[i] + shift * slope,
            there[i],
            rtol=LINEAR_TOLERANCE,
            atol=LINEAR_TOLERANCE * np.max(np.abs(here[i])),
        )
        for i, slope in slopes.items()
    )
    # a number keeps its sign
    low, high = (0.0, np.inf) if value > 0 else (-np.inf, 0.0) if value < 0 else (-np.inf, np.inf)
    return Parameter(path, Direction(slopes, value, linear), value, low, high, _unit(path))


def _unit(path: str) -> str:
    """Unit of the number at a path; lengths along a line are in lists that have no declaration."""
    return "m" if ScenePath(path).key in ("length", "at") else describe(path).get("unit", "-")


# A scene with fitted values, ready to simulate


def fitted_scene(scene: Scene, model: Model, parameters: Sequence[Parameter], values: np.ndarray) -> Scene:
    """The scene with the values (k,) of those parameters that belong to it, without sensors' and cameras'.

    One entry of a number that the scene gives once for all links is written together with the other entries.

    Args:
        model: the fitted one.
    """
    for p, value in zip(parameters, values, strict=True):
        if scene.branched and p.in_model and p.where.section == "lines":
            scene = _of_all_lines(scene, p.where, float(value))
            continue
        try:
            scene.value(p.name)
        except SceneError:
            scene = _entry_by_entry(scene, model, p)
            continue
        scene = scene.with_values({p.name: float(value)})
    return scene


def _of_all_lines(scene: Scene, where: ModelPlace, value: float) -> Scene:
    """The scene with a value of one link, counted among those of all lines, as in the model of a system."""
    left = where.entry or 0
    for i, line in enumerate(scene.lines):
        if left < line.links:
            each = np.array(np.broadcast_to(np.asarray(getattr(line, where.field), float), line.links))
            each[left] = value
            return scene.with_values({f"line.{i}.{where.field}": each.tolist()})
        left -= line.links
    return scene


def _entry_by_entry(scene: Scene, model: Model, p: Parameter) -> Scene:
    if not p.in_model:
        return scene
    whole = np.asarray(getattr(getattr(model, p.where.section)[p.where.index], p.where.field), float)
    return scene.with_values({ScenePath(p.name).stem: whole.tolist()})


# Names of free parameters: full paths, unique short names, or by default the scene's damping

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
    known = None if all(_is_full(name) for name in names) else paths(build_model(scene))
    return [name if _is_full(name) else _full(name, known, option) for name in names]


def _is_full(name: str) -> bool:
    sections = ("camera", "clock", "marker", "parameters", "release", "rig")
    return name.count(".") >= 2 or (ScenePath(name).section in sections and "." in name)


def _full(name: str, names: Sequence[str], option: str) -> str:
    if not name:
        raise SceneError(f"{option}: an empty name; allowed: names of parameters, separated by commas")
    stem, _, entry = name.partition(".")
    names = [p for p in names if not p.startswith("line.") or p.split(".")[1].isdecimal()]
    found = [p for p in names if ScenePath(p).key == stem]
    if not found:
        found = [f"effects.{effect}.{key}" for effect, keys in DAMPING.items() for key in keys if key == stem]
    if len(found) != 1:
        short = sorted({ScenePath(p).key for p in names} | {key for keys in DAMPING.values() for key in keys})
        raise SceneError(f"{option}: {name!r} does not exist in the scene; {nearest(stem, short + names)}")
    return found[0] + (f".{entry}" if entry else "")
