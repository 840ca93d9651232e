"""Varied inputs of a sweep: their paths and values, and how each value enters the model."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import jax
import numpy as np

from dropper_jax import Scene
from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import ScenePath
from dropper_jax.load.original_lines import locate_written
from dropper_jax.load.paths import Steps, describe, locate
from dropper_jax.model import Model
from dropper_jax.modelling.build import build_model
from dropper_jax.modelling.scene_model import bare_model
from fitting.parameters.names import DAMPING_PATHS, full_names
from fitting.parameters.parameter import Parameter, with_parameter_values
from fitting.parameters.paths import resolve


@dataclass(frozen=True)
class Axis:
    """One varied path: its values, and the model's numbers that it sets (none: it goes through the scene).

    Attributes:
        resizes: whether its values change the number of links or nodes.
    """

    path: str
    values: np.ndarray
    parameters: tuple[Parameter, ...] = ()
    moves_start: bool = True
    resizes: bool = False

    @property
    def unit(self) -> str:
        """Unit of the values; empty if they have none."""
        if self.parameters:
            return self.parameters[0].unit
        return describe(self.path).get("unit", "")

    def plain(self, value: float) -> float:
        """A value as the scene takes it: counts stay whole."""
        return self.values.dtype.type(value).item()


def read_values(path: str, values: Sequence[float]) -> np.ndarray:
    """The values of a varied path (k,).

    Raises:
        SceneError: an empty list, or numbers that are not finite.
    """
    found = np.asarray(values)
    is_number = found.dtype.kind in "iuf"
    if not is_number or found.ndim != 1 or found.size == 0 or not np.isfinite(found).all():
        raise SceneError(f"vary: {path}: no finite numbers; allowed: at least one")
    return found


def full_paths(scene: Scene, names: list[str]) -> list[str]:
    """Full paths; short names are those of `dropper fit`."""
    found = []
    for name in names:
        if ScenePath(name).section == "run":
            raise SceneError(f"vary: {name!r} belongs to the compiled program. Use one sweep for each value")
        if name.count(".") < 2:
            (name,) = full_names(scene, [name], "vary")
        found.append(name)
    check_different(scene, found)
    return found


def check_different(scene: Scene, paths: Sequence[str]) -> None:
    """Reject a path that is given twice, and two paths of one value, such as a line's by its number and by its name."""
    steps = locate(scene.to_dict(), paths) | locate_written(scene.as_written())
    first: dict[Steps, str] = {}
    for path in paths:
        stem, entries = ScenePath(path).entry_of(steps) or (path, ())
        value = (*steps.get(stem, (stem,)), *entries)
        if value not in first:
            first[value] = path
        elif first[value] == path:
            raise SceneError(f"vary: {path!r} is given twice; allowed: every path once")
        else:
            raise SceneError(f"vary: {first[value]!r} and {path!r} are the same number; allowed: every number once")


def first_seed(scene: Scene) -> int:
    """The seed of the scene's wave spectrum, from which those of further realisations count up."""
    waves = (scene.to_dict().get("sea") or {}).get("waves") or {}
    if waves.get("kind") != "spectrum":
        raise SceneError("seeds: nothing in this scene is random. Use a scene whose sea has a wave spectrum")
    return int(waves.get("seed", 0))


def make_axis(scene: Scene, path: str, values: np.ndarray) -> Axis:
    """How a path's values enter the model.

    They replace numbers of the model if the lowest and the highest one, set there, give the model of the scene with
    that value. A list with a value that the scene rejects goes through the scene, which decides on each of them.
    """
    if changes_size(scene, path, values):
        return Axis(path, values, resizes=True)
    model = build_model(scene)
    try:
        parameters = resolve(model, [path], option="vary")
        for end in (values.min().item(), values.max().item()):
            inside = with_parameter_values(model, parameters, np.full(len(parameters), float(end)))
            if not same_numbers(inside, build_model(scene.with_values({path: end}))):
                return Axis(path, values)
    except SceneError:
        return Axis(path, values)
    moves_start = ScenePath(path).stem not in DAMPING_PATHS
    return Axis(path, values, parameters, moves_start)


def changes_size(scene: Scene, path: str, values: np.ndarray) -> bool:
    """Whether the lowest and the highest value that the scene accepts give different numbers of links or nodes."""
    rising = np.unique(values).tolist()
    lowest = _first_accepted(scene, path, rising)
    highest = _first_accepted(scene, path, rising[::-1])
    if lowest is None or highest is None:
        return False
    one = bare_model(lowest)
    other = bare_model(highest)
    return one.line.links != other.line.links or one.free_nodes != other.free_nodes


def _first_accepted(scene: Scene, path: str, values: list[float]) -> Scene | None:
    """The scene with the first of these values that it accepts."""
    for value in values:
        with suppress(SceneError):
            return scene.with_values({path: value})
    return None


def same_numbers(one: Model, other: Model) -> bool:
    """Whether two models have the same numbers."""
    a = jax.tree.leaves(one)
    b = jax.tree.leaves(other)
    return jax.tree.structure(one) == jax.tree.structure(other) and all(map(np.array_equal, a, b))
