"""Forces of lines on fixed points, and tensions at the line ends, over a whole run."""

from __future__ import annotations

import numpy as np

from dropper_jax.scene import SceneData, line_slices, whole_lines


def positions_at(t: np.ndarray, positions: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Positions (q, ...) [m] at times (q,) [s], linear between the saved positions (k, ...) at t (k,) [s]."""
    if len(t) < 2:
        return positions[np.zeros(len(times), int)]
    row = np.interp(times, t, np.arange(len(t)))
    low = np.minimum(row.astype(int), len(t) - 2)
    share = (row - low).reshape(-1, *[1] * (positions.ndim - 1))
    return (1 - share) * positions[low] + share * positions[low + 1]


def point_load(
    scene: SceneData, name: str, t: np.ndarray, positions: np.ndarray, t_tension: np.ndarray, tension: np.ndarray
) -> np.ndarray:
    """Force (q, 3) [N] of all lines on a point: the sum of `T_j d_j/|d_j|` over the links j that end there.

    d_j is the link from the point outwards, at the times of the tensions.

    Args:
        t, positions: saved times (k,) [s] and nodes (k, nodes, 3) [m] of all lines.
        t_tension, tension: (q,) [s] and (q, links) [N].
    """
    total = np.zeros((len(t_tension), 3))
    for spec, where in zip(scene.lines, line_slices(scene), strict=True):
        ends = (
            (spec.start, slice(where.nodes.start, where.nodes.start + 2), where.links.start, 1.0),
            (spec.end, slice(where.nodes.stop - 2, where.nodes.stop), where.links.stop - 1, -1.0),
        )
        for point, nodes, link, sign in ends:
            if point == name:
                both = positions_at(t, positions[:, nodes], t_tension)
                along = sign * (both[:, 1] - both[:, 0])
                size = np.linalg.norm(along, axis=1, keepdims=True)
                total += tension[:, link, None] * along / np.where(size > 0, size, 1.0)
    return total


def held_points(scene: SceneData) -> list[str]:
    """Names of the fixed points at which a line ends."""
    ends = {name for line in scene.lines for name in (line.start, line.end)}
    return [point.name for point in scene.points if point.kind == "fixed" and point.name in ends]


def end_tensions(scene: SceneData, tension: np.ndarray) -> dict[str, np.ndarray]:
    """Tension (k, 2) [N] of the first and the last link of every line, pieces between attached points together."""
    return {line.name: tension[:, [line.links.start, line.links.stop - 1]] for line in whole_lines(scene)}
