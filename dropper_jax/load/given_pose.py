"""A start of one line whose pose is given: its nodes, and whether they fit the line and its ends."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.scene import SceneData, directions

#: Relative mismatch of a given pose with lengths and held ends that is still taken for rounding.
POSE_TOLERANCE = 1e-6


def given_pose(scene: SceneData) -> tuple[str, np.ndarray] | None:
    """The path of a given start of one line, and its nodes (n + 1, 3) [m]; None for the static one."""
    line, start = scene.lines[0], scene.start
    if start.kind == "static":
        return None
    if start.kind == "positions":
        return "start.positions", start.positions
    steps = line.length[:, None] * directions(start.polar, start.azimuth, start.zero)
    first = scene.point(line.start).position
    return "start.polar", first + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def check_pose(scene: SceneData, path: str, nodes: np.ndarray) -> None:
    """A given pose must start and end where the line is held, and have the lengths of rigid links."""
    line = scene.lines[0]
    first, last = scene.point(line.start), scene.point(line.end)
    ends = [(0, first)] + ([(line.links, last)] if last.kind == "fixed" else [])
    for i, point in ends:
        if np.linalg.norm(nodes[i] - point.position) > POSE_TOLERANCE * line.total:
            raise SceneError(
                f"{path}: node {i} is at {_place(nodes[i])} m; allowed: {_place(point.position)} m, "
                f"where {point.name!r} holds it"
            )
    sizes = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    wrong = np.flatnonzero(np.abs(sizes - line.length) > POSE_TOLERANCE * line.length)
    if line.rigid and wrong.size:
        j = wrong[0]
        raise SceneError(f"{path}: link {j + 1} is {sizes[j]:.9g} m long; allowed: its length {line.length[j]:.9g} m")


def _place(position: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:.9g}" for x in position) + ")"
