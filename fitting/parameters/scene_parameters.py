"""Parameters that are numbers of the scene, not of the model: the length of a whole line, EA of a line type, a buoy.

Such a number changes many numbers of the model at once (the length of a line its links' lengths, masses and internal
damping). Their derivatives are found by differences on the host, once; in the compiled program the model changes along
that direction.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

import jax
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import ScenePath, Values, declared_fields
from dropper_jax.load.original_lines import locate_written
from dropper_jax.load.paths import describe
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.modelling.build import build_model
from dropper_jax.modelling.model_slopes import changes_in_range, model_slopes
from fitting.parameters.parameter import Parameter, check_once
from fitting.parameters.paths import Released, declared_bounds, resolve
from fitting.parameters.targets import Direction

#: A model counts as linear in a number if the first of these relative changes that the scene takes moves it linearly to
#: within `LINEAR_TOLERANCE`.
LINEAR_REACHES = (0.2, -0.2, 0.02, -0.02)
LINEAR_TOLERANCE = 1e-9


def find_parameters(
    scene: Scene, model: Model, names: Sequence[str], option: str, idle: bool = False
) -> tuple[Parameter, ...]:
    """The parameters of these paths: numbers of the model, otherwise of the scene.

    If lines are specified by the metre, paths have the same meaning as in the file: `line.leg.length` is the whole
    line.

    Args:
        idle: whether a number of the scene may be without effect on the model.

    Raises:
        SceneError: a path that is neither.
    """
    found: list[Parameter] = []
    written = locate_written(scene.as_written())
    for name in names:
        if name in written or ScenePath(name).section == "parameters" or scene.sets_other_gravity(name):
            found.append(scene_parameter(scene, model, name, idle))
            continue
        try:
            found += resolve(model, [name], option=option)
        except SceneError as unresolved:
            error = unresolved
            try:
                found.append(scene_parameter(scene, model, name, idle))
            except SceneError as reason:
                with suppress(SceneError):
                    scene.value(name)  # the scene has it, but it cannot vary
                    error = reason
                raise error from None
    check_once(found, option)
    return tuple(found)


def scene_parameter(scene: Scene, model: Model, path: str, idle: bool = False) -> Parameter:
    """The number of the scene at a path, and its effect on the model, which may be none if it may be `idle`.

    Raises:
        SceneError: no such path, not a number, a number without effect on the model, or one that changes its shape.
    """
    slopes = model_slopes(scene, model, path, idle)
    value: Any = scene.value(path)
    here = jax.tree.leaves(build_model(scene.with_values({path: value})))
    shift, there = _shifted_leaves(scene, path, value)
    linear = True
    for i, slope in slopes.items():
        old = np.asarray(here[i])
        close = LINEAR_TOLERANCE * np.max(np.abs(old), where=np.isfinite(old), initial=0.0)
        linear &= np.allclose(old + shift * slope, there[i], rtol=LINEAR_TOLERANCE, atol=close)
    if ScenePath(path).section == "parameters":
        unit = _moved_unit(model, slopes)
    elif ScenePath(path).key in ("length", "at"):  # lengths along a line are in lists that have no declaration
        unit = "m"
    else:
        unit = describe(path).get("unit", "-")
    changes = changes_in_range(scene, path, value)
    # a number keeps its sign, and stays on its side of an end of its range
    low = -np.inf
    high = np.inf
    if changes[0] >= 0.0:
        low = value
    elif value > 0.0:
        low = 0.0
    if changes[-1] <= 0.0:
        high = value
    elif value < 0.0:
        high = 0.0
    where = Direction(slopes, value, linear)
    if linear:
        allowed_low, allowed_high = _allowed_range(model, where)
        low = max(low, allowed_low)
        high = min(high, allowed_high)
    return Parameter(path, where, value, low, high, unit)


def _shifted_leaves(scene: Scene, path: str, value: float) -> tuple[float, list[Any]]:
    """The first change of a number by `LINEAR_REACHES` that the scene takes, and the leaves of its model."""
    errors = []
    for reach in LINEAR_REACHES:
        shift = reach * (abs(value) or 1.0)
        try:
            return shift, jax.tree.leaves(build_model(scene.with_values({path: value + shift})))
        except SceneError as error:
            errors.append(error)
    raise errors[0]


def _allowed_range(model: Model, where: Direction) -> tuple[float, float]:
    """The values of a number of the scene at which all numbers of the model that follow it are in their ranges."""
    leaves = jax.tree.leaves(model)
    low = -np.inf
    high = np.inf
    for leaf, slope in where.slopes.items():
        moving = slope != 0.0
        now = np.asarray(leaves[leaf])[moving]
        limits = declared_bounds(_declaration(model, leaf), now)
        ends = np.sort([(limit - now) / slope[moving] for limit in limits], axis=0)
        low = max(low, ends[0].max())
        high = min(high, ends[1].min())
    # inside by the rounding of slopes, because the scene must take a value at its bound
    rounding = LINEAR_TOLERANCE * abs(where.origin)
    return _clear_zero(where.origin + min(low + rounding, 0.0), rounding), where.origin + max(high - rounding, 0.0)


def _clear_zero(end: float, rounding: float) -> float:
    """An end of a range; exactly 0 where it is 0 up to rounding."""
    return 0.0 if abs(end) <= 2.0 * rounding else float(end)


def _moved_unit(model: Model, slopes: Iterable[int]) -> str:
    """Unit of the model's leaves of these numbers if they share one, otherwise `-`."""
    units = {_declaration(model, leaf).get("unit", "-") for leaf in slopes}
    if len(units) == 1:
        return units.pop()
    return "-"


def _declaration(model: Model, leaf: int) -> Values:
    """Declaration of the field that holds a leaf of the model, by its number; empty if it is not declared."""
    path, _ = jax.tree_util.tree_flatten_with_path(model)[0][leaf]
    item: Any = model
    for key in path[:-1]:
        item = item[key.idx] if hasattr(key, "idx") else getattr(item, key.name)
    declared = declared_fields(type(item)).get(getattr(path[-1], "name", ""))
    if declared is None:
        return {}
    return declared.metadata


def free_of_traces(
    scene: Scene, model: Model, names: Sequence[str], release: Released | None = None
) -> tuple[Parameter, ...]:
    """The free parameters of a fit to angles: numbers of the model, camera, clock and release, and of `[parameters]`.

    A number of `[parameters]` ties the values that the scene computes from it, and gravity acts on weights and water.

    Raises:
        SceneError: a path that does not exist, or such a number that moves the model non-linearly.
    """
    found: list[Parameter] = []
    for name in names:
        if ScenePath(name).section != "parameters" and not scene.sets_other_gravity(name):
            found += resolve(model, [name], release=release)
            continue
        tied = scene_parameter(scene, model, name)
        if isinstance(tied.where, Direction) and not tied.where.linear:
            raise SceneError(
                f"free: {name!r} changes the model non-linearly, which fits to angles do not follow; allowed: numbers "
                'whose values are proportional to them, such as b_l = ["= head", "= head", "= tail"]'
            )
        found.append(tied)
    check_once(found, "free")
    return tuple(found)
