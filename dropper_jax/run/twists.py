"""Twist and torque along lines with torsion, from what the effect kept."""

from __future__ import annotations

import numpy as np

from dropper_jax.load.scene import Scene
from dropper_jax.scene import line_slices


def torque(scene: Scene, positions: np.ndarray, twist: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """`Q = GJ tau/l + c tau'/l + k_tt e` (k, n) [N m] of the links (see `effects.torsion`).

    Args:
        positions: all nodes (k, nodes, 3) [m]; twist, rate: (k, nodes) [rad], [rad/s].
    """
    given, links = scene.effects["torsion"], sum(line.links for line in scene.lines)
    stiffness, damping = (np.broadcast_to(given[key], links) for key in ("GJ", "damping"))
    coupling = None if given["coupling"] is None else np.broadcast_to(given["coupling"], links)
    found = np.zeros((len(positions), links))
    for line, where in zip(scene.lines, line_slices(scene), strict=True):
        if given["lines"] and line.name not in given["lines"]:
            continue
        at = where.links
        tau, turning = (np.diff(a[:, where.nodes], axis=1) / line.length for a in (twist, rate))
        found[:, at] = stiffness[at] * tau + damping[at] * turning
        if coupling is not None:
            length = np.linalg.norm(np.diff(positions[:, where.nodes], axis=1), axis=-1)
            found[:, at] += coupling[at] * (length / line.length - 1.0)
    return found
