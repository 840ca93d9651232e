"""A scene with fitted values, ready to simulate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import ScenePath
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from fitting.parameters.parameter import Parameter
from fitting.parameters.targets import ModelTarget, RigScale


def fitted_scene(scene: Scene, model: Model, parameters: Sequence[Parameter], values: np.ndarray) -> Scene:
    """The scene with the values (k,) of those parameters that belong to it, without sensors' and cameras'.

    One entry of a number that the scene gives once for all links is written together with the other entries.

    Args:
        model: the fitted one.
    """
    scale = None
    for p, value in zip(parameters, values, strict=True):
        if isinstance(p.where, RigScale):
            scale = float(value)
        else:
            scene = _with_value(scene, model, p, float(value))
    if scale is not None:
        scene = _scaled(scene, model, scale)
    return scene


def _with_value(scene: Scene, model: Model, p: Parameter, value: float) -> Scene:
    """The scene with the value of a parameter, unchanged if it has no such number."""
    where = p.where
    if scene.single_line is None and isinstance(where, ModelTarget) and where.section == "lines":
        return _of_all_lines(scene, where, value)
    try:
        scene.value(p.name)
    except SceneError:
        if not isinstance(where, ModelTarget):
            return scene
        whole = np.asarray(getattr(getattr(model, where.section)[where.index], where.field), float)
        return scene.with_values({ScenePath(p.name).stem: whole.tolist()})
    return scene.with_values({p.name: value})


def _scaled(scene: Scene, model: Model, scale: float) -> Scene:
    """The scene with the lengths of the fitted model, and its points at scaled positions.

    A line that is specified by the metre has its whole length scaled, so that its mass grows with it.
    """
    positions = {}
    for i, point in enumerate(scene.points):
        positions[f"point.{i}.position"] = (scale * np.asarray(point.position, float)).tolist()
    scene = scene.with_values(positions)
    ends = np.cumsum([line.links for line in scene.lines])
    for i, (line, end) in enumerate(zip(scene.lines, ends, strict=True)):
        lengths = {}
        for field in ("length", "centre_of_mass", "inertia"):
            whole = getattr(model.line, field)
            if whole is not None:
                lengths[f"line.{i}.{field}"] = np.asarray(whole, float)[end - line.links : end].tolist()
        try:
            scene = scene.with_values(lengths)
        except SceneError:
            length = f"line.{i}.length"
            scene = scene.with_values({length: (scale * np.asarray(scene.value(length))).tolist()})
    return scene


def _of_all_lines(scene: Scene, where: ModelTarget, value: float) -> Scene:
    """The scene with a value of one link, counted among those of all lines, as in the model of a system."""
    ends = np.cumsum([line.links for line in scene.lines])
    i = np.searchsorted(ends, where.entry or 0, side="right")
    line = scene.lines[i]
    each = np.array(np.broadcast_to(np.asarray(getattr(line, where.field), float), line.links))
    each[(where.entry or 0) - ends[i]] = value
    return scene.with_values({f"line.{i}.{where.field}": each.tolist()})
