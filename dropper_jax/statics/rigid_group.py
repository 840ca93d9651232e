"""Stiffness of points that move together as one rigid body, about a reference point: a mooring as the floater feels it.

    K = sum_ij A_i' S_ij A_j - sum_i [F_i x] [a_i x],    A_i = (1, -[a_i x])

S is the stiffness of the points, F_i the force of the lines on point i, a_i its arm from the reference, [a x] the
matrix of the cross product. The second term, in the rotations only, is the turn of the arms under the forces that are
there. Rows and columns are surge, sway and heave of the reference, and rotations about the scene's axes there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.records import names_of
from dropper_jax.model import Model, State
from dropper_jax.statics.rest_problem import check_point_names, held_names, rest
from dropper_jax.statics.stiffness import FREEDOMS, Stiffness, forces_on_held, mooring_stiffness


def stiffness_of_group(
    model: Model, pose: State, names: Sequence[str], about: Sequence[float] | np.ndarray, label: str = "group"
) -> Stiffness:
    """The stiffness (6, 6) of fixed points that move as one rigid body.

    Args:
        pose: `equilibrium(...).state`.
        names: of the points, all fixed.
        about: reference point (3,) [m].
        label: name of the group in the result.

    Raises:
        SceneError: no points, unknown or free points, rigid links.
    """
    if not names:
        raise SceneError(f"points: {label!r} has none; allowed: one or more fixed points")
    known = names_of(model.points)
    held = held_names(model)
    check_point_names(names, known)
    for name in names:
        if name not in held:
            reason = "is free, and a rigid group consists of fixed points"
            raise SceneError(f"points: {name!r} {reason}; allowed: {', '.join(held)}")
    found = mooring_stiffness(model, pose, names)
    forces = forces_on_held(rest(model), pose)[list(map(held.index, names))]
    arms = np.array([model.points[known.index(name)].position for name in names]) - np.asarray(about, float)
    moves = np.concatenate([np.hstack([np.eye(3), -_cross(arm)]) for arm in arms])
    matrix = moves.T @ found.matrix @ moves
    for force, arm in zip(forces, arms, strict=True):
        matrix[3:, 3:] -= _cross(force) @ _cross(arm)
    return Stiffness((label,), tuple(f"{label}.{axis}" for axis in FREEDOMS), matrix, found.warnings)


def moved_to(matrix: np.ndarray, arm: Sequence[float]) -> np.ndarray:
    """The stiffness (6, 6) of a body in equilibrium about a reference that is `arm` (3,) [m] away."""
    moves = np.eye(6)
    moves[:3, 3:] = _cross(np.asarray(arm, float))
    return moves.T @ matrix @ moves


def _cross(a: np.ndarray) -> np.ndarray:
    """The matrix [a x] of the cross product with a (3,)."""
    return np.cross(np.eye(3), a)
