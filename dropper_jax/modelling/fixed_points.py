"""Scenes and models whose points are fixed: the lines alone, and lines without the body that carries them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.records import names_of
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.model import Displacement, Model, State


def with_points_fixed(model: Model) -> Model:
    """The lines alone, with all points fixed at their positions in the scene."""
    graph = replace(model.geometry, held=(True,) * len(model.points))
    carried = ("point_bodies", "spar_buoys")
    effects = tuple(e for e in model.without_slot(Displacement).effects if not (e.name in carried or e.bodily))
    return replace(model, lines=(replace(model.line, geometry=graph),), effects=effects)


def without_body(scene: Scene, body: str, model: Model, pose: State) -> tuple[Scene, list[str]]:
    """The scene with the points on a body fixed where they rest, in place of the body, and the names of the points."""
    names = [point.name for point in scene.points if point.carrier == body]
    if not names:
        raise SceneError(f"body {body!r}: no line is attached to it")
    known = names_of(model.points)
    table = scene.to_dict()
    table["body"] = [other for other in table["body"] if other["name"] != body]
    for name in names:
        node = model.geometry.node_of_point(known.index(name))
        table["point"].append({"name": name, "position": np.asarray(pose.r)[node].tolist()})
    table["start"] = {"kind": "static"}
    return load_scene(table), names
