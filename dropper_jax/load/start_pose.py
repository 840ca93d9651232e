"""The configuration in which a scene starts, where it is given: angles that close, and checks against its lines."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dropper_jax.base.errors import Check, SceneError, raises_first
from dropper_jax.load.checks_system import check_span
from dropper_jax.scene import LineSpec, SceneData, StartSpec, directions, sliced_lines
from dropper_jax.scene.start import rows_of_pieces

#: Relative mismatch of a given configuration with lengths and fixed ends that is still attributed to rounding.
POSE_TOLERANCE = 1e-6
#: The same for angles that are closed on loading: files contain angles with four or five decimals.
CLOSED_TOLERANCE = 1e-4
#: Length of an elastic link over its unstretched length from which measured positions are not those of its line.
MAX_STRETCH = 2.0


def given_pose(scene: SceneData) -> tuple[str, np.ndarray] | None:
    """The path of a given start, and the nodes (n + 1, 3) [m] of the line, or those of all lines of a system; None for
    a static start."""
    line = scene.lines[0]
    start = scene.start
    if start.positions is not None:
        return "start.positions", start.positions
    if start.polar is None or start.azimuth is None or start.zero is None:
        return None
    steps = line.length[:, None] * directions(start.polar, start.azimuth, start.zero)
    first = scene.point(line.start).position
    return "start.polar", first + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def closed_start(scene: SceneData) -> StartSpec:
    """The start of one line between fixed points with angles that close, if only rounding prevented it.

    The smallest change of the polar and azimuth angles is used. Other starts, and angles with a larger mismatch, are
    returned unchanged and rejected by `check_pose`.
    """
    line = scene.lines[0]
    start = scene.start
    end = scene.point(line.end)
    polar = start.polar
    azimuth = start.azimuth
    zero = start.zero
    if polar is None or azimuth is None or zero is None or end.is_free:
        return start
    span = end.position - scene.point(line.start).position
    missing = span - line.length @ directions(polar, azimuth, zero)
    if not POSE_TOLERANCE * line.total < np.linalg.norm(missing) <= CLOSED_TOLERANCE * line.total:
        return start
    # Newton steps that close angles; starting from a mismatch of `CLOSED_TOLERANCE`, two reach rounding error
    for _ in range(4):
        # a quarter turn further is the derivative of a direction with respect to its azimuth, without z
        by_polar = directions(polar + np.pi / 2, azimuth, zero)
        by_azimuth = directions(polar, azimuth + np.pi / 2, zero) * [1.0, 1.0, 0.0]
        slope = np.concatenate([line.length[:, None] * by_polar, line.length[:, None] * by_azimuth])
        change = np.split(np.linalg.lstsq(slope.T, missing, rcond=1e-9)[0], 2)
        polar = polar + change[0]
        azimuth = azimuth + change[1]
        missing = span - line.length @ directions(polar, azimuth, zero)
    return replace(start, polar=polar, azimuth=azimuth)


@raises_first
def check_pose(scene: SceneData, line: LineSpec, path: str, nodes: np.ndarray, before: int = 0) -> Iterator[Check]:
    """Check that a given configuration starts and ends at the line's fixed points and has the lengths of rigid
    links.

    Args:
        nodes: of the line (links + 1, 3) [m]; before: number of nodes of other lines before it in the list.
    """
    for i, point in ((0, scene.point(line.start)), (line.links, scene.point(line.end))):
        away = math.dist(nodes[i], point.position)
        yield (
            away > POSE_TOLERANCE * line.total and not point.is_free,
            f"{path}: node {before + i} is at {_point_text(nodes[i])} m; allowed: {_point_text(point.position)} m, "
            f"the position of {point.name!r}",
        )
    sizes = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    for j in np.flatnonzero(np.abs(sizes - line.length) > POSE_TOLERANCE * line.length):
        yield line.rigid, f"{path}: link {j + 1} is {sizes[j]:.9g} m long; allowed: its length {line.length[j]:.9g} m"


def check_system_pose(scene: SceneData) -> None:
    """Check the start of a system of lines: rigid links that hang between the points where these are, and positions.

    Raises:
        SceneError: links too short for their points, bodies, or positions that disagree with points, with links, or
            with each other.
    """
    if scene.start.kind == "points":
        for i, line in enumerate(scene.lines):
            if line.rigid and line.links > 1:
                check_span(scene, i)
    positions = scene.start.positions
    if positions is None:
        return
    if scene.bodies:
        raise SceneError("start.kind: 'positions' gives nodes of lines only; allowed: in scenes without bodies")
    rows = rows_of_pieces(scene.lines)
    found: dict[str, tuple[int, np.ndarray]] = {}
    for line, where in sliced_lines(scene):
        nodes = positions[where.nodes]
        path = f"start.positions: line {line.name!r}"
        check_pose(scene, line, path, nodes, int(rows[where.nodes.start]))
        sizes = np.linalg.norm(np.diff(nodes, axis=0), axis=1) / line.length
        worst = np.argmax(sizes)
        if sizes[worst] > MAX_STRETCH:
            raise SceneError(
                f"{path}: link {worst + 1} is {sizes[worst]:.4g} times as long as unstretched; allowed: up to "
                f"{MAX_STRETCH:g}. Check unit and order of the nodes"
            )
        for i, name in ((0, line.start), (line.links, line.end)):
            row = int(rows[where.nodes.start + i])
            other, position = found.setdefault(name, (row, nodes[i]))
            if np.linalg.norm(nodes[i] - position) > POSE_TOLERANCE * line.total:
                raise SceneError(
                    f"start.positions: nodes {other} and {row} are both point {name!r}, but at "
                    f"{_point_text(position)} m and {_point_text(nodes[i])} m; allowed: one position"
                )


def _point_text(position: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:.9g}" for x in position) + ")"
