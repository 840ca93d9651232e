"""A scene with fitted values, ready to simulate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from fitting.parameters.parameter import Parameter
from fitting.parameters.target import ModelPlace


def fitted_scene(scene: Scene, model: Model, parameters: Sequence[Parameter], values: np.ndarray) -> Scene:
    """The scene with the values (k,) of those parameters that belong to it, without sensors' and cameras'.

    One entry of a number that the scene gives once for all links is written together with the other entries.

    Args:
        model: the fitted one.
    """
    for p, value in zip(parameters, values, strict=True):
        if scene.branched and isinstance(p.where, ModelPlace) and p.where.section == "lines":
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
    if not isinstance(p.where, ModelPlace):
        return scene
    whole = np.asarray(getattr(getattr(model, p.where.section)[p.where.index], p.where.field), float)
    path = p.name if p.where.entry is None else p.name.rsplit(".", 1)[0]
    return scene.with_values({path: whole.tolist()})
