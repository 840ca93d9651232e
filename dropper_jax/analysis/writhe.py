"""Turns by which a line untwists as it coils."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.numerics import unit_vectors


def writhe(nodes: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Turns (k,) by which a line with non-rotating ends would untwist as it coils [-].

    The area that its tangent t sweeps on the unit sphere, seen from `direction`, divided by 2 pi (Fuller 1978):
    `1/(2 pi) int (d x t) . t'/(1 + d . t) ds`, here the exact sum over the triangles of the links' directions. A helix
    of n turns at the angle a to its axis gives `n (1 - cos a)`; a plane line with its ends along d gives none.

    Args:
        nodes: positions along the line (k, nodes, 3) [m].
        direction: d (3,), the direction of the straight line; without one (zero) nothing is swept as seen from it: 0.
    """
    t = unit_vectors(np.diff(nodes, axis=1))
    d = unit_vectors(np.asarray(direction, float))
    a = t[:, :-1]
    b = t[:, 1:]
    volume = np.cross(a, b) @ d
    around = 1.0 + a @ d + b @ d + np.sum(a * b, axis=-1)
    return np.sum(2.0 * np.arctan2(volume, around), axis=1) / (2.0 * np.pi)
