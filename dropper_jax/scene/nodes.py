"""Nodes at the points of a scene."""

from __future__ import annotations

from dropper_jax.scene.data import SceneData
from dropper_jax.scene.slices import line_slices


def point_nodes(scene: SceneData) -> dict[str, int]:
    """By name of a point, the first node of the lines' arrays at that point."""
    found: dict[str, int] = {}
    for line, where in zip(scene.lines, line_slices(scene), strict=True):
        found.setdefault(line.start, where.nodes.start)
        found.setdefault(line.end, where.nodes.stop - 1)
    return found
