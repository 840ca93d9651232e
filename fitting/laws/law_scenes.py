"""Scenes with all parts of a damping law, so that a fit can free them, and without those that it does not need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dropper_jax.base.read import ScenePath
from dropper_jax.load.scene import Scene
from fitting.laws.laws import JOINT_PARTS, LAW_PARTS
from fitting.parameters.parameter import given_effect, with_zero_damping


def scene_with_law(scene: Scene, dry: bool, friction: Mapping[str, float], separate: Sequence[str]) -> Scene:
    """The scene with every part of a damping law, with or without dry friction; missing parts are 0.

    Args:
        friction: values of parts of the joints; the others keep those of the scene.
        separate: parts of which every joint has a coefficient of its own.
    """
    table = scene.to_dict()
    fields = table["effects"].setdefault("joint_friction", {})
    joints = len(scene.lines[0].length) + 1
    for part in JOINT_PARTS:
        field = ScenePath(LAW_PARTS[part]).key
        value = friction.get(part)
        if value is None:
            value = fields.get(field) or 0.0
        if part in separate and not isinstance(value, list):
            value = [value] * joints
        fields[field] = value
    fields.setdefault("axis", [0.0, 1.0, 0.0])
    if not dry:
        fields.pop("dry", None)
    return with_zero_damping(Scene.from_dict(table), paths_of_law(dry))


def paths_of_law(dry: bool) -> list[str]:
    """Paths of all parts of a damping law, with or without dry friction."""
    return [path for part, path in LAW_PARTS.items() if dry or part != "dry"]


def without_unused_parts(scene: Scene, given: Scene, free: Sequence[str]) -> Scene:
    """The scene without parts of a damping law that are neither `given` nor free: they are 0."""
    coefficients = {ScenePath(path).key for path in LAW_PARTS.values()}
    table = scene.to_dict()
    for path in LAW_PARTS.values():
        _, effect, field = path.split(".")
        fields = table["effects"].get(effect, {})
        if given_effect(given, path) is None and not any(name.startswith(path) for name in free):
            fields.pop(field, None)
        if effect not in given.effects and not fields.keys() & coefficients:  # an axis alone does not define friction
            table["effects"].pop(effect, None)
    return Scene.from_dict(table)
