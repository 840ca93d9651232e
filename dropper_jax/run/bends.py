"""Curvature and bending moment along lines with bending stiffness, from the positions of their nodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.load.scene import Scene
from dropper_jax.scene import line_slices

#: Curvature below which a radius is that of a straight line [1/m].
STRAIGHT = 1e-12


def bends(scene: Scene) -> bool:
    """Whether lines of the scene have bending stiffness."""
    return "bending" in scene.effects


def curvature(scene: Scene, positions: np.ndarray) -> np.ndarray:
    """`kappa = |q_(j+1) - q_j|/l` (k, nodes) [1/m] as `effects.bending` has it: 0 at pinned ends.

    q are directions of links, l the mean length of a node's two; at a clamped end q_0 is the clamp's and l half a link.

    Args:
        positions: all nodes, line after line (k, nodes, 3) [m].
    """
    found = np.zeros(positions.shape[:2])
    clamps = _clamps(scene)
    for line, where in zip(scene.lines, line_slices(scene), strict=True):
        nodes = positions[:, where.nodes]
        links = np.diff(nodes, axis=1)
        size = np.linalg.norm(links, axis=-1, keepdims=True)
        q, length = links / np.where(size > 0.0, size, 1.0), np.asarray(line.length, float)
        own = found[:, where.nodes]
        own[:, 1:-1] = np.linalg.norm(q[:, 1:] - q[:, :-1], axis=-1) / (0.5 * (length[1:] + length[:-1]))
        for node, link, name, sign in ((0, 0, line.start, 1.0), (-1, -1, line.end, -1.0)):
            if name in clamps:
                own[:, node] = np.linalg.norm(q[:, link] - sign * clamps[name], axis=-1) / (0.5 * length[link])
    return found


def bending_moment(
    scene: Scene, positions: np.ndarray, t: np.ndarray, broken: tuple[dict[str, Any], ...]
) -> np.ndarray:
    """`M = EI kappa` (k, nodes) [N m]; zero next to a broken link."""
    kappa = curvature(scene, positions)
    given = np.asarray(scene.effects["bending"]["EI"], float)
    stiffness = np.broadcast_to(given, sum(line.links for line in scene.lines))
    for where in line_slices(scene):
        each = stiffness[where.links]
        kappa[:, where.nodes] *= np.concatenate([each[:1], 0.5 * (each[1:] + each[:-1]), each[-1:]])
        for row in broken:
            if row["line"] == where.name:
                beside = slice(where.nodes.start + row["link"] - 1, where.nodes.start + row["link"] + 1)
                kappa[t > row["time_s"], beside] = 0.0
    return kappa


def _clamps(scene: Scene) -> dict[str, np.ndarray]:
    """Directions (3,) in which lines leave their clamped points."""
    given = scene.effects["bending"]
    if not given["clamped"]:
        return {}
    return {name: d / np.linalg.norm(d) for name, d in zip(given["clamped"], given["directions"], strict=True)}


def bending_summary(
    scene: Scene, t: np.ndarray, kappa: np.ndarray, moment: np.ndarray
) -> dict[str, dict[str, float | None]]:
    """Maximum moment [N m] of each line with its arc length [m] and time [s], and the minimum radius [m].

    Lines that stay straight have the radius None.
    """
    found = {}
    for line, where in zip(scene.lines, line_slices(scene), strict=True):
        own, bent = moment[:, where.nodes], float(np.max(kappa[:, where.nodes]))
        when, node = np.unravel_index(np.argmax(own), own.shape)
        found[line.name] = {
            "largest_moment_n_m": float(own[when, node]),
            "at_m": float(np.sum(line.length[:node])),
            "t_s": float(t[when]),
            "least_radius_m": 1.0 / bent if bent > STRAIGHT else None,
        }
    return found
