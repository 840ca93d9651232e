"""Derivatives of the numbers of a model with respect to a number of its scene."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.modelling.build import build_model

#: Relative step of the differences.
STEP = 1e-3
#: Changes at which a number is sampled, in steps: on both sides of it, or on one where its range ends.
CHANGES = ((-1.0, -0.5, 0.5, 1.0), (0.0, 1 / 3, 2 / 3, 1.0), (-1.0, -2 / 3, -1 / 3, 0.0))


def changes_in_range(scene: Scene, path: str, value: float) -> np.ndarray:
    """Relative changes (4,) of a number of the scene that keep it in its range, in rising order.

    A number that is zero changes by the change itself.

    Raises:
        SceneError: the scene refuses changes to either side.
    """
    size = abs(value) or 1.0
    refused = []
    for changes in CHANGES:
        try:
            for change in (changes[0], changes[-1]):
                scene.with_values({path: value + change * STEP * size})
        except SceneError as error:
            refused.append(error)
            continue
        return np.array(changes) * STEP
    raise refused[0]


def model_slopes(scene: Scene, model: Model, path: str, idle: bool = False) -> dict[int, np.ndarray]:
    """Derivatives of the leaves of a scene's model with respect to a number of the scene, by number of the leaf.

    Slopes of a cubic through four samples on the host: an error of 1e-12 for smooth functions, and of 1e-9 at an end of
    the number's range.

    Args:
        path: of the number in the scene.
        idle: whether a number without effect on the model is allowed.

    Raises:
        SceneError: not a number, a number without effect on the model, or one that changes its shape.
    """
    value = scene.value(path)
    if isinstance(value, bool) or not isinstance(value, float):
        raise SceneError(f"{path}: {value!r} is not a number that can vary. Use paths of such numbers")
    size = abs(value) or 1.0
    shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves(model)]

    changes = changes_in_range(scene, path, value)
    samples = []
    for change in changes:
        changed = build_model(scene.with_values({path: value + change * size}))
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(changed)]
        if [leaf.shape for leaf in leaves] != shapes:
            raise SceneError(f"{path}: changes the model's shape, such as a number of links. Use `dropper sweep`")
        samples.append(leaves)
    # the weights give the slope of 1, x, x^2 and x^3 at the number exactly
    weights = np.linalg.solve(np.vander(changes / STEP, increasing=True).T, [0.0, 1.0, 0.0, 0.0]) / (STEP * size)
    slopes = {}
    for i, leaf in enumerate(zip(*samples, strict=True)):
        moved = [_differences(sample, leaf[0]) for sample in leaf]
        if np.any(moved):
            slopes[i] = np.tensordot(weights, moved, axes=1)
    if not (slopes or idle):
        raise SceneError(f"{path}: has no effect on the model. Use numbers that do")
    return slopes


def _differences(after: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Differences of numbers, zero where both are infinite, such as loads at which nothing breaks."""
    return np.subtract(after, before, out=np.zeros(after.shape), where=after != before)


def shift_model(model: Model, moving: Sequence[int], rows: Sequence[Array | np.ndarray], shift: Array) -> Model:
    """The model with leaves of the numbers `moving` changed by `shift` (p,) times `rows` (p, ...) of each;
    differentiable."""
    leaves, tree = jax.tree.flatten(model)
    for i, row in zip(moving, rows, strict=True):
        leaves[i] = leaves[i] + jnp.tensordot(shift, row, axes=1)
    return jax.tree.unflatten(tree, leaves)
