"""A system in pictures: fixed points, joints, buoys, bodies, the surface, the bed; and snapshots of it."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from dropper_jax.base.constants import DEGREE
from dropper_jax.load.checks_water import bed_height
from dropper_jax.plots import style, view
from dropper_jax.plots.run import SIDES, Run, elevations

BUOY = style.CYCLE[4]
WATER = "#DCEBF5"
SURFACE = style.CYCLE[5]
BED = "#D8CBB4"
EDGE = "#A87400"


def draw_solids(axes: Axes, run: Run, index: int, axis: int = 0, grow: bool = False) -> None:
    """Buoys and bodies at a sample: their sections in the plane of x (0) or y (1) and z, or their faces in space.

    With `grow` the limits of the axes are extended to include them.
    """
    nodes = run.positions[index]
    bodies = run.bodies
    if isinstance(axes, Axes3D):
        if run.buoys:
            sections = list(outlines(run, nodes, right_of(axes)))
            axes.add_collection(Poly3DCollection(sections, facecolors=BUOY, edgecolors=style.DARK, linewidths=0.8))
        if bodies is not None and bodies.shapes:
            faces = [face for rings in bodies.rings(index) for face in _faces(rings)]
            axes.add_collection(Poly3DCollection(faces, facecolors=BUOY, edgecolors=EDGE, linewidths=0.15))
        return
    sections = list(outlines(run, nodes, np.eye(3)[axis])[..., [axis, 2]])
    if bodies is not None:
        sections += bodies.outlines(index, lambda positions: positions[:, [axis, 2]])
    if sections:
        solids = PolyCollection(sections, zorder=2.5, facecolors=BUOY, edgecolors=style.DARK, linewidths=0.8)
        axes.add_collection(solids, autolim=grow)


def _faces(rings: np.ndarray) -> list[np.ndarray]:
    """Sides between rings, and both ends."""
    found = [rings[0], rings[-1]]
    for low, high in pairwise(rings):
        found += [np.stack([low[i - 1], low[i], high[i], high[i - 1]]) for i in range(SIDES)]
    return found


@style.with_style
def body_motion(run: Run, path: str | Path) -> Path:
    """Heave [m] and displacement [m], roll and pitch [deg] of each body against time.

    Returns:
        path of the picture; its suffix chooses the format.
    """
    bodies = run.bodies
    if bodies is None:
        raise ValueError(f"solution: scene {run.scene.name!r} has no [[body]]. Use a scene with bodies")
    figure = style.new_figure(8.5, 6.2)
    panels = figure.subplots(3, 1, sharex=True)
    way = bodies.position[..., :2] - bodies.position[:1, :, :2]
    for i, name in enumerate(bodies.names):
        colour = style.CYCLE[i % len(style.CYCLE)]
        panels[0].plot(run.t, np.hypot(way[:, i, 0], way[:, i, 1]), color=colour, lw=1.0, label=name)
        panels[1].plot(run.t, bodies.position[:, i, 2], color=colour, lw=1.0)
        for j, dash in ((1, "-"), (0, "--")):
            turn = DEGREE * bodies.attitude[:, i, j]
            if j == 1 or np.ptp(turn) > 0.1:
                panels[2].plot(run.t, turn, color=colour, lw=1.0, ls=dash)
    for axes, label in zip(panels, ("displacement [m]", "heave [m]", "pitch, roll dashed [deg]"), strict=True):
        axes.set_ylabel(label)
    if len(bodies.names) > 1:
        panels[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2)
    style.time_axis(panels[2], run.t)
    return style.finish(figure, run, "motion of the bodies", path)


def limits(run: Run, positions: np.ndarray) -> np.ndarray:
    """Limits (3, 2) [m] of a picture: the nodes, the buoys, and the seabed and surface near them."""
    nodes = positions.reshape(-1, 3)
    shown = [nodes]
    for buoy in run.buoys:
        base = positions.reshape(-1, run.positions.shape[1], 3)[:, buoy.node] - [0.0, 0.0, buoy.attachment]
        shown += [base, base + [0.0, 0.0, buoy.height]]
    if run.bodies is not None and run.bodies.shapes:
        shown.append(run.bodies.extent_points())
    low = nodes.min(axis=0)
    high = nodes.max(axis=0)
    # the surface and the seabed are in the picture if they are within this distance of the lines, in sizes of the lines
    near = 0.5 * (high - low).max()
    middle = 0.5 * (low + high)
    bed = bed_height(run.scene, middle[None])
    for z in ([] if run.scene.sea is None else [0.0]) + ([] if bed is None else [float(bed[0])]):
        if low[2] - near <= z <= high[2] + near:
            shown.append(np.array([[middle[0], middle[1], z]]))
    return view.box(np.concatenate(shown), min_ratio=0.25)


def bare_joints(run: Run, nodes: np.ndarray) -> np.ndarray:
    """Positions (m, 3) of the free points without a buoy that join several lines."""
    busy = {buoy.node for buoy in run.buoys}
    return nodes[[node for node in run.joints if node not in busy]]


def outlines(run: Run, nodes: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Corners (buoys, 4, 3) [m] of each buoy's upright section, seen in a view whose right is `right` (3,)."""
    found = np.zeros((len(run.buoys), 4, 3))
    for corners, buoy in zip(found, run.buoys, strict=True):
        base = nodes[buoy.node] - [0.0, 0.0, buoy.attachment]
        side = 0.5 * buoy.diameter * right
        top = base + [0.0, 0.0, buoy.height]
        corners[:] = base - side, base + side, top + side, top - side
    return found


def right_of(axes: Axes) -> np.ndarray:
    """The horizontal unit vector (3,) that points to the right in the picture."""
    if not isinstance(axes, Axes3D):
        return np.array([1.0, 0.0, 0.0])
    turn = np.radians(axes.azim)
    return np.array([-np.sin(turn), np.cos(turn), 0.0])


def surface_lines(run: Run, box: np.ndarray, flat: bool, times: np.ndarray) -> np.ndarray | None:
    """The surface (k, lines, points, 3) [m] at times (k,): a line in a plane, a net in space; None without water."""
    if run.scene.sea is None:
        return None
    x = np.linspace(*box[0], 161)
    y = np.linspace(*box[1], 161)
    if flat:
        lines = np.stack([x, np.full_like(x, box[1].mean()), np.zeros_like(x)], axis=-1)[None]
    else:
        rows = np.linspace(*box[0], 13)
        columns = np.linspace(*box[1], 13)
        along = [np.stack([np.full_like(y, one), y, np.zeros_like(y)], axis=-1) for one in rows]
        lines = np.stack(along + [np.stack([x, np.full_like(x, one), np.zeros_like(x)], axis=-1) for one in columns])
    found = np.tile(lines, (len(times), 1, 1, 1))
    found[..., 2] = elevations(run.scene, lines.reshape(-1, 3), times).reshape(found.shape[:-1])
    return found


def bed_grid(run: Run, x: np.ndarray, y: np.ndarray) -> tuple[list[np.ndarray], np.ndarray | None]:
    """Positions of a grid and the height [m] of the seabed there; None without a seabed."""
    grid = list(np.meshgrid(x, y, indexing="ij"))
    return grid, bed_height(run.scene, np.stack([*grid, np.zeros_like(grid[0])], axis=-1))


def draw_bed(axes: Axes, run: Run, box: np.ndarray) -> None:
    """The seabed: a filled strip in a plane, a faint sheet in space; nothing if no seabed is in the picture."""
    x = np.linspace(*box[0], 41)
    y = np.linspace(*box[1], 41)
    if not isinstance(axes, Axes3D):
        z = bed_height(run.scene, np.stack([x, np.full_like(x, box[1].mean()), np.zeros_like(x)], axis=-1))
        if z is not None and z.max() > box[2, 0]:
            axes.fill_between(x, box[2, 0], z, color=BED, lw=0, zorder=0.5)
        return
    grid, z = bed_grid(run, x, y)
    if z is not None and z.max() > box[2, 0]:
        axes.plot_surface(
            *grid, np.maximum(z, box[2, 0]), color=BED, alpha=0.35, lw=0, shade=False, rcount=20, ccount=20
        )
