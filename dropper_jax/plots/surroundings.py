"""What pictures show around the lines: buoys, bodies, the surface and the seabed, and the limits that contain them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from dropper_jax.load.surface import bed_height
from dropper_jax.plots import view
from dropper_jax.plots.run import Run, elevations
from dropper_jax.plots.style import CYCLE, DARK

BUOY = CYCLE[4]
WATER = "#DCEBF5"
SURFACE = CYCLE[5]
BED = "#D8CBB4"
EDGE = "#A87400"


def draw_solids(axes: Axes, run: Run, index: int, axis: int = 0, grow: bool = False) -> None:
    """Buoys and bodies at a sample: their sections in the plane of x (0) or y (1) and z, or their faces in space.

    With `grow` the limits of the axes are extended to include them.
    """
    if isinstance(axes, Axes3D):
        _draw_faces(axes, run, index)
        return
    shapes = list(outlines(run, run.positions[index], np.eye(3)[axis])[..., [axis, 2]])
    if run.bodies is not None:
        shapes += run.bodies.outlines(index, lambda positions: positions[:, [axis, 2]])
    if shapes:
        solids = PolyCollection(shapes, zorder=2.5, facecolors=BUOY, edgecolors=DARK, linewidths=0.8)
        axes.add_collection(solids, autolim=grow)


def _draw_faces(axes: Axes3D, run: Run, index: int) -> None:
    """Buoys and the faces of bodies in space."""
    if run.buoys:
        sections = list(outlines(run, run.positions[index], right_of(axes)))
        axes.add_collection(Poly3DCollection(sections, facecolors=BUOY, edgecolors=DARK, linewidths=0.8))
    if run.bodies is not None and run.bodies.shapes:
        faces = [face for rings in run.bodies.rings(index) for face in _faces(rings)]
        axes.add_collection(Poly3DCollection(faces, facecolors=BUOY, edgecolors=EDGE, linewidths=0.15))


def _faces(rings: np.ndarray) -> Iterator[np.ndarray]:
    """Both ends, and sides between rings (rings, SIDES, 3)."""
    yield from (rings[0], rings[-1])
    following = np.roll(rings, -1, axis=1)
    sides = np.stack([rings[:-1], following[:-1], following[1:], rings[1:]], axis=2)
    yield from sides.reshape(-1, 4, 3)


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
    levels = [] if run.scene.sea is None else [0.0]
    bed = bed_height(run.scene, middle[None])
    if bed is not None:
        levels.append(bed[0])
    for z in levels:
        if low[2] - near <= z <= high[2] + near:
            shown.append(np.array([[*middle[:2], z]]))
    return view.box(np.concatenate(shown), min_ratio=0.25)


def outlines(run: Run, nodes: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Corners (buoys, 4, 3) [m] of each buoy's upright section, seen in a view whose right is `right` (3,)."""
    node, diameter, height, attachment = np.reshape(run.buoys, (-1, 4)).T
    upwards = np.array([0.0, 0.0, 1.0])
    base = nodes[node.astype(int)] - np.outer(attachment, upwards)
    side = 0.5 * np.outer(diameter, right)
    top = base + np.outer(height, upwards)
    return np.stack([base - side, base + side, top + side, top - side], axis=1)


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
        pairs = [(x, box[1].mean())]
    else:
        pairs = [(one, y) for one in np.linspace(*box[0], 13)] + [(x, one) for one in np.linspace(*box[1], 13)]
    lines = np.array([np.stack(np.broadcast_arrays(*pair, 0.0), axis=-1) for pair in pairs])
    found = np.tile(lines, (len(times), 1, 1, 1))
    found[..., 2] = elevations(run.scene, lines.reshape(-1, 3), times).reshape(found.shape[:-1])
    return found


def bed_grid(run: Run, x: np.ndarray, y: np.ndarray) -> tuple[Sequence[np.ndarray], np.ndarray | None]:
    """Positions of a grid and the height [m] of the seabed there; None without a seabed."""
    grid = np.meshgrid(x, y, indexing="ij")
    return grid, bed_height(run.scene, np.stack([*grid, np.zeros_like(grid[0])], axis=-1))


def draw_bed(axes: Axes, run: Run, box: np.ndarray) -> None:
    """The seabed: a filled strip in a plane, a faint sheet in space; nothing if no seabed is in the picture."""
    flat = not isinstance(axes, Axes3D)
    x = np.linspace(*box[0], 41)
    y = box[1].mean(keepdims=True) if flat else np.linspace(*box[1], 41)
    low = box[2, 0]
    grid, z = bed_grid(run, x, y)
    if z is None or z.max() <= low:
        return
    if flat:
        axes.fill_between(x, low, z[:, 0], color=BED, lw=0, zorder=0.5)
    else:
        axes.plot_surface(*grid, np.maximum(z, low), color=BED, alpha=0.35, lw=0, shade=False, rcount=20, ccount=20)
