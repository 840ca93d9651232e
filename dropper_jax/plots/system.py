"""Parts of a system of lines other than links in pictures: fixed points, joints, buoys, the surface and the seabed."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from dropper_jax.load.checks_water import bed_height, surface_over
from dropper_jax.plots import style, view
from dropper_jax.plots.run import Run

BUOY, WATER, SURFACE, BED = style.CYCLE[4], "#DCEBF5", style.CYCLE[5], "#D8CBB4"
#: The surface and the seabed are in the picture if they are within this distance of the lines, in sizes of the lines.
NEAR = 0.5
#: Points along a surface line, and number of lines of a surface in space per side.
ALONG, ACROSS = 161, 13


def limits(run: Run, positions: np.ndarray) -> np.ndarray:
    """Limits (3, 2) [m] of a picture: the nodes and, of a system, its buoys, and the seabed and surface near them."""
    if run.scene is None:
        return view.box(positions)
    nodes = positions.reshape(-1, 3)
    shown = [nodes]
    for buoy in run.buoys:
        base = positions.reshape(-1, run.positions.shape[1], 3)[:, buoy.node] - [0.0, 0.0, buoy.attachment]
        shown += [base, base + [0.0, 0.0, buoy.height]]
    if run.bodies is not None and run.bodies.shapes:
        shown.append(run.bodies.extent_points())
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    near = NEAR * (high - low).max()
    middle = 0.5 * (low + high)
    bed = bed_height(run.scene, middle[None])
    for z in ([] if run.scene.sea is None else [0.0]) + ([] if bed is None else [float(bed[0])]):
        if low[2] - near <= z <= high[2] + near:
            shown.append(np.array([[middle[0], middle[1], z]]))
    return view.box(np.concatenate(shown), least=0.25)


def held_positions(run: Run, positions: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Positions (m, 3) of the fixed points in one configuration; of a single line those of its ends that never move."""
    return view.fixed_ends(positions) if run.scene is None else nodes[list(run.held)]


def bare_joints(run: Run, nodes: np.ndarray) -> np.ndarray:
    """Positions (m, 3) of the free points without a buoy that join several lines."""
    busy = {buoy.node for buoy in run.buoys}
    return nodes[[node for node in run.joints if node not in busy]]


def outlines(run: Run, nodes: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Corners (buoys, 4, 3) [m] of each buoy's upright section, seen in a view whose right is `right` (3,)."""
    found = np.zeros((len(run.buoys), 4, 3))
    for corners, buoy in zip(found, run.buoys, strict=True):
        base, side = nodes[buoy.node] - [0.0, 0.0, buoy.attachment], 0.5 * buoy.diameter * right
        top = base + [0.0, 0.0, buoy.height]
        corners[:] = base - side, base + side, top + side, top - side
    return found


def right_of(axes: Axes, flat: bool) -> np.ndarray:
    """The horizontal unit vector (3,) that points to the right in the picture."""
    if flat:
        return np.array([1.0, 0.0, 0.0])
    turn = np.radians(axes.azim)
    return np.array([-np.sin(turn), np.cos(turn), 0.0])


def surface_lines(run: Run, box: np.ndarray, flat: bool, times: np.ndarray) -> np.ndarray | None:
    """The surface (k, lines, points, 3) [m] at times (k,): a line in a plane, a net in space; None without water."""
    if run.scene is None or run.scene.sea is None:
        return None
    x, y = (np.linspace(*box[axis], ALONG) for axis in (0, 1))
    if flat:
        lines = np.stack([x, np.full_like(x, box[1].mean()), np.zeros_like(x)], axis=-1)[None]
    else:
        rows, columns = (np.linspace(*box[axis], ACROSS) for axis in (0, 1))
        along = [np.stack([np.full_like(y, one), y, np.zeros_like(y)], axis=-1) for one in rows]
        lines = np.stack(along + [np.stack([x, np.full_like(x, one), np.zeros_like(x)], axis=-1) for one in columns])
    positions = np.broadcast_to(lines.reshape(1, -1, 3), (len(times), lines.shape[0] * lines.shape[1], 3))
    eta = surface_over(run.scene, positions, times)
    found = np.array(positions)
    found[..., 2] = eta
    return found.reshape(len(times), *lines.shape)


def draw_bed(axes: Axes, run: Run, box: np.ndarray, flat: bool) -> None:
    """The seabed: a filled strip in a plane, a faint sheet in space; nothing if no seabed is in the picture."""
    if run.scene is None:
        return
    x, y = (np.linspace(*box[axis], 41) for axis in (0, 1))
    if flat:
        z = bed_height(run.scene, np.stack([x, np.full_like(x, box[1].mean()), np.zeros_like(x)], axis=-1))
        if z is not None and z.max() > box[2, 0]:
            axes.fill_between(x, box[2, 0], z, color=BED, lw=0, zorder=0.5)
        return
    grid = np.meshgrid(x, y, indexing="ij")
    z = bed_height(run.scene, np.stack([*grid, np.zeros_like(grid[0])], axis=-1))
    if z is not None and z.max() > box[2, 0]:
        axes.plot_surface(
            *grid, np.maximum(z, box[2, 0]), color=BED, alpha=0.35, lw=0, shade=False, rcount=20, ccount=20
        )
