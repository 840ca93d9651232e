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

#: Relative steps of the two central differences; the second is half the first (Richardson).
STEP = 1e-3


def model_slopes(scene: Scene, model: Model, path: str, idle: bool = False) -> dict[int, np.ndarray]:
    """Derivatives of the leaves of a scene's model with respect to a number of the scene, by number of the leaf.

    By central differences on the host over two relative steps, extrapolated: an error of 1e-12 for smooth functions.

    Args:
        path: of the number in the scene.
        idle: whether a number without effect on the model is allowed.

    Raises:
        SceneError: not a number, a number without effect on the model, or one that changes its shape.
    """
    value = scene.value(path)
    if isinstance(value, bool) or not isinstance(value, float):
        raise SceneError(f"{path}: {value!r} is not a number that can vary. Use paths of such numbers")
    size = abs(value) or 1.0  # a number that is zero changes by the step itself
    shapes = [jnp.shape(leaf) for leaf in jax.tree.leaves(model)]

    def leaves_at(shift: float) -> list[np.ndarray]:
        """Leaves of the model with the number changed by a fraction `shift`."""
        changed = build_model(scene.with_values({path: value + shift * size}))
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(changed)]
        if [leaf.shape for leaf in leaves] != shapes:
            raise SceneError(f"{path}: changes the model's shape, such as a number of links. Use `dropper sweep`")
        return leaves

    def slopes_over(step: float) -> list[np.ndarray]:
        """Central differences of the leaves."""
        above = leaves_at(step)
        below = leaves_at(-step)
        return [(a - b) / (2 * step * size) for a, b in zip(above, below, strict=True)]

    coarse = slopes_over(STEP)
    fine = slopes_over(0.5 * STEP)
    slopes = {}
    for i, (wide, narrow) in enumerate(zip(coarse, fine, strict=True)):
        if np.any(narrow != 0):
            slopes[i] = (4 * narrow - wide) / 3  # cancels the error of second order in the step
    if not (slopes or idle):
        raise SceneError(f"{path}: has no effect on the model. Use numbers that do")
    return slopes


def shift_model(model: Model, moving: Sequence[int], rows: Sequence[Array | np.ndarray], shift: Array) -> Model:
    """The model with leaves of the numbers `moving` changed by `shift` (p,) times `rows` (p, ...) of each;
    differentiable."""
    leaves, tree = jax.tree.flatten(model)
    for i, row in zip(moving, rows, strict=True):
        leaves[i] = leaves[i] + jnp.tensordot(shift, row, axes=1)
    return jax.tree.unflatten(tree, leaves)
