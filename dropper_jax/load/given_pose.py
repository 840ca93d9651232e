"""A start of one line with given configuration: its nodes, and whether they fit the line and its ends."""

from __future__ import annotations

import dataclasses

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.scene import SceneData, StartSpec, directions

#: Relative mismatch of a given configuration with lengths and fixed ends that is still attributed to rounding.
POSE_TOLERANCE = 1e-6
#: The same for angles that are closed on loading: files contain angles with four or five decimals.
CLOSED_TOLERANCE = 1e-4
#: Newton steps that close angles; starting from a mismatch of `CLOSED_TOLERANCE`, two reach rounding error.
CLOSING_STEPS = 4


def given_pose(scene: SceneData) -> tuple[str, np.ndarray] | None:
    """The path of a given start of one line, and its nodes (n + 1, 3) [m]; None for a static start."""
    line, start = scene.lines[0], scene.start
    if start.kind == "static":
        return None
    if start.kind == "positions":
        return "start.positions", start.positions
    steps = line.length[:, None] * directions(start.polar, start.azimuth, start.zero)
    first = scene.point(line.start).position
    return "start.polar", first + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def closed_start(scene: SceneData) -> StartSpec:
    """The start of one line between fixed points with angles that close, if only rounding prevented it.

    The smallest change of the polar and azimuth angles is used. Other starts, and angles with a larger mismatch, are
    returned unchanged and rejected by `check_pose`.
    """
    line, start = scene.lines[0], scene.start
    end = scene.point(line.end)
    if start.kind != "angles" or end.kind != "fixed":
        return start
    span = end.position - scene.point(line.start).position
    missing = lambda s: span - line.length @ directions(s.polar, s.azimuth, s.zero)  # noqa: E731
    if not POSE_TOLERANCE * line.total < np.linalg.norm(missing(start)) <= CLOSED_TOLERANCE * line.total:
        return start
    for _ in range(CLOSING_STEPS):
        # a quarter turn further is the derivative of a direction with respect to its azimuth, without z
        by_polar = directions(start.polar + np.pi / 2, start.azimuth, start.zero)
        by_azimuth = directions(start.polar, start.azimuth + np.pi / 2, start.zero) * [1.0, 1.0, 0.0]
        slope = np.concatenate([line.length[:, None] * by_polar, line.length[:, None] * by_azimuth])
        polar, azimuth = np.split(np.linalg.lstsq(slope.T, missing(start), rcond=1e-9)[0], 2)
        start = dataclasses.replace(start, polar=start.polar + polar, azimuth=start.azimuth + azimuth)
    return start


def check_pose(scene: SceneData, path: str, nodes: np.ndarray) -> None:
    """Check that a given configuration starts and ends at the line's fixed points and has the lengths of rigid
    links."""
    line = scene.lines[0]
    first, last = scene.point(line.start), scene.point(line.end)
    ends = [(0, first)] + ([(line.links, last)] if last.kind == "fixed" else [])
    for i, point in ends:
        if np.linalg.norm(nodes[i] - point.position) > POSE_TOLERANCE * line.total:
            raise SceneError(
                f"{path}: node {i} is at {_point_text(nodes[i])} m; allowed: {_point_text(point.position)} m, "
                f"the position of {point.name!r}"
            )
    sizes = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    wrong = np.flatnonzero(np.abs(sizes - line.length) > POSE_TOLERANCE * line.length)
    if line.rigid and wrong.size:
        j = wrong[0]
        raise SceneError(f"{path}: link {j + 1} is {sizes[j]:.9g} m long; allowed: its length {line.length[j]:.9g} m")


def _point_text(position: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:.9g}" for x in position) + ")"
