"""Forces and angles of lines at their ends, from nodes and tensions (see `quantities.end_links`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.load.scene import Scene
from dropper_jax.quantities.end_links import EndLinks, Motion, ends_of, point_loads
from dropper_jax.scene import LineSlice, WholeLine, whole_lines


def end_forces(
    scene: Scene,
    positions: np.ndarray,
    tension: np.ndarray,
    lines: Sequence[WholeLine | LineSlice] | None = None,
    t: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Force (k, 2) [N] of every line on its first and its last point, by name (see `quantities.end_links`).

    The force is the tension of the end link plus the weight of the part of the link that belongs to the point, less its
    buoyancy as far as it is in the water: the tension of a link is that at its middle. At a point on the seabed the bed
    carries this part as far as the line does not lift it. Drag and inertia of this part are left out.

    Args:
        positions: nodes of all lines (k, nodes, 3) [m]; tension: of their links (k, n) [N].
        lines: their indices in these arrays; default: lines as in the scene, pieces between attached points together.
        t: times (k,) [s], for the level and the waves; default: the level at t = 0 without waves.
    """
    lines = whole_lines(scene) if lines is None else lines
    vectors = end_force_vectors(scene, positions, tension, lines, t)
    return {name: np.linalg.norm(both, axis=2) for name, both in vectors.items()}


def end_force_vectors(
    scene: Scene,
    positions: np.ndarray,
    tension: np.ndarray,
    lines: Sequence[WholeLine | LineSlice],
    t: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """The forces of `end_forces` as vectors (k, 2, 3) [N]."""
    links = EndLinks(scene, waves=t is not None)
    times = np.zeros(len(positions)) if t is None else t
    found = {}
    for line in lines:
        both = [links.force(end, positions[:, end.nodes], tension, times) for end in ends_of(line)]
        found[line.name] = np.stack(both, axis=1)
    return found


def fixed_point_loads(
    scene: Scene, positions: np.ndarray, tension: np.ndarray, t: float = 0.0
) -> dict[str, np.ndarray]:
    """Force (3,) [N] of all lines on each fixed point in a static configuration, by name (see `quantities.end_links`).

    Args:
        positions: nodes of all lines (nodes, 3) [m]; tension: of their links (n,) [N].
        t: time [s], for the level.
    """
    times = np.array([t])
    loads = point_loads(Motion(scene, times, positions[None], times, tension[None]), waves=False)
    return {name: load[0] for name, load in loads.items()}


def end_angles(positions: np.ndarray, lines: Sequence[WholeLine | LineSlice]) -> dict[str, np.ndarray]:
    """Angle (k, 2) [deg] above the horizontal of every line as it leaves its first and its last point, by name.

    It is that of the end link: the uplift at the anchor of a single line, negative where a line hangs below its point.

    Args:
        positions: nodes of all lines (k, nodes, 3) [m].
    """
    found = {}
    for line in lines:
        points, inner = np.transpose([end.nodes for end in ends_of(line)])
        with np.errstate(invalid="ignore"):  # a failed run may end with infinite positions
            along = positions[:, inner] - positions[:, points]
            found[line.name] = np.degrees(np.arctan2(along[..., 2], np.hypot(along[..., 0], along[..., 1])))
    return found
