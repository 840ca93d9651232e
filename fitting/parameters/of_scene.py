"""Parameters that are numbers of the scene, not of the model: the length of a whole line, EA of a line type, a buoy.

Such a number changes many numbers of the model at once (the length of a line its links' lengths, masses and internal
damping). Their derivatives are found by differences on the host, once; in the compiled program the model changes along
that direction.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.line_types import LineType
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.run.build import build_model
from dropper_jax.scene import BuoySpec, PointSpec
from dropper_jax.sea.spec import CurrentSpec, SeaSpec, WaveSpec
from fitting.parameters.parameter import Parameter, check_once, resolve
from fitting.parameters.target import Direction

#: Relative steps of the differences; two of them, extrapolated, have an error of 1e-12 for smooth functions.
STEPS = (1e-3, 5e-4)
#: A model that this change moves linearly to within `STRAIGHT` counts as linear in the number.
FAR, STRAIGHT = 0.2, 1e-9


def find_parameters(scene: Scene, model: Model, names: Sequence[str], option: str) -> tuple[Parameter, ...]:
    """The parameters of these paths: numbers of the model, otherwise of the scene.

    If lines are specified by the metre, paths have the same meaning as in the file: `line.leg.length` is the whole
    line.

    Raises:
        SceneError: a path that is neither.
    """
    found: list[Parameter] = []
    for name in names:
        written = scene.written is not None and name in scene.written.locate_values(scene.as_written())
        if written or name.startswith("parameters."):
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
    value = scene.value(path)
    if isinstance(value, bool) or not isinstance(value, float):
        raise SceneError(f"{path}: {value!r} is not a number that can vary. Use paths of such numbers")
    size = abs(value) or 1.0

    def at(shift: float) -> list[np.ndarray]:
        changed = build_model(scene.with_values({path: value + shift * size}))
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(changed)]
        if [leaf.shape for leaf in leaves] != [jnp.shape(leaf) for leaf in jax.tree.leaves(model)]:
            raise SceneError(f"{path}: changes the model's shape. Use numbers that do not")
        return leaves

    wide, narrow = ([(a - b) / (2 * step * size) for a, b in zip(at(step), at(-step), strict=True)] for step in STEPS)
    slopes = {i: (4 * b - a) / 3 for i, (a, b) in enumerate(zip(wide, narrow, strict=True)) if np.any(b != 0)}
    if not slopes:
        raise SceneError(f"{path}: has no effect on the model. Use numbers that do")
    here, there = at(0.0), at(FAR)
    linear = all(
        np.allclose(here[i] + FAR * size * slope, there[i], rtol=STRAIGHT, atol=STRAIGHT * np.max(np.abs(here[i])))
        for i, slope in slopes.items()
    )
    # a number keeps its sign
    low, high = (0.0, np.inf) if value > 0 else (-np.inf, 0.0) if value < 0 else (-np.inf, np.inf)
    return Parameter(path, Direction(slopes, value, linear), value, low, high, _unit(path))


def _unit(path: str) -> str:
    """Unit of the field that a path ends with."""
    kinds = {"line_type": LineType, "buoy": BuoySpec, "point": PointSpec}
    section, key = path.split(".")[0], path.rsplit(".", 1)[1]
    if section == "line":
        return "m" if key in ("length", "at") else "-"
    if section == "sea":
        kinds["sea"] = {"waves": WaveSpec, "current": CurrentSpec}.get(path.split(".")[1], SeaSpec)
    fields = {f.name: f for f in dataclasses.fields(kinds[section])} if section in kinds else {}
    return fields[key].metadata.get("unit", "-") if key in fields else "-"
