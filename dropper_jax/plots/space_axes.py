"""Axes of a view in space: their box, names outside their tick labels, and the colour bar."""

from __future__ import annotations

from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D, axis3d, proj3d

from dropper_jax.plots.view import LONGEST_SIDE

#: Space for labels, title and colour bar around the box: left, right, bottom and top [inch].
SPACE_MARGINS = (0.35, 1.75, 0.75, 0.45)
#: Distance of the name of an axis in space from its tick labels [inch].
NAME_GAP = 0.06


def space_axes(figure: Figure, limits: np.ndarray, longest: float = LONGEST_SIDE) -> Axes3D:
    """Axes in space, equal scales, in a figure that fits them: the drawn box is at most `longest` [inch] wide."""
    side = limits[:, 1] - limits[:, 0]
    rect = (0.0, 0.0, 1.0, 1.0)
    axes = cast(Axes3D, figure.add_axes(rect, projection="3d", elev=18, azim=-58, box_aspect=side))
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    _fit_figure(figure, axes, limits, longest)
    for axis, part in zip((axes.xaxis, axes.yaxis, axes.zaxis), side / side.max(), strict=True):
        intervals = 2 if part < 0.6 else 5
        axis.set_major_locator(MaxNLocator(intervals))
        axis.set_pane_color((0.97, 0.97, 0.98, 1.0))
    axes.tick_params(labelsize=8, pad=1)
    _name_axes(figure, axes)
    return axes


def _name_axes(figure: Figure, axes: Axes3D) -> None:
    """Names of the axes in space, outside their tick labels, and these outside the box.

    Matplotlib sets both by the lengths of the sides, so that they overlap each other or the box if one is short.
    """
    figure.draw_without_rendering()  # edges and tick labels get their positions
    centre = axes.transAxes.transform((0.5, 0.5))
    for axis, name in ((axes.xaxis, "x [m]"), (axes.yaxis, "y [m]"), (axes.zaxis, "z [m]")):
        start, end = axes.transData.transform(np.transpose(axis.line.get_data()))
        middle = 0.5 * (start + end)
        along = (end - start) / np.linalg.norm(end - start)
        outwards = np.array([along[1], -along[0]])
        outwards *= np.sign(outwards @ (middle - centre))
        side = "left" if outwards[0] > 0 else "right"
        for tick in axis.get_major_ticks():  # away from the edge, and from the labels of the next one
            tick.label1.set_horizontalalignment(side)
        reach = (_tick_corners(axis) - middle) @ outwards
        turn = (np.degrees(np.arctan2(along[1], along[0])) + 90.0) % 180.0 - 90.0
        text = figure.text(0.0, 0.0, name, ha="center", va="center", rotation=turn, rotation_mode="anchor")
        distance = reach.max(initial=0.0) + (NAME_GAP + 0.5 * float(text.get_fontsize()) / 72.0) * figure.dpi
        x, y = figure.transFigure.inverted().transform(middle + distance * outwards)
        text.set_position((x, y))


def _tick_corners(axis: axis3d.Axis) -> np.ndarray:
    """Corners (4 n, 2) [pixel] of the tick labels in the picture.

    `get_majorticklabels` would put them where they are in a plane.
    """
    low, high = axis.get_view_interval()
    labels = [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
    return np.concatenate([np.zeros((0, 2)), *(label.get_window_extent().corners() for label in labels)])


def _fit_figure(figure: Figure, axes: Axes3D, limits: np.ndarray, longest: float) -> None:
    """Size of the figure and position of the axes, a square that may reach beyond it, for the projected box."""
    figure.set_size_inches(1.0, 1.0)
    axes.apply_aspect()
    corners = np.array(np.meshgrid(*limits)).reshape(3, -1)
    seen = np.stack(proj3d.proj_transform(*corners, axes.get_proj())[:2], axis=1)
    seen = axes.transAxes.inverted().transform(axes.transData.transform(seen))
    low = seen.min(axis=0)
    extent = seen.max(axis=0) - low
    side = longest / extent.max()
    left, right, bottom, top = SPACE_MARGINS
    size = side * extent + [left + right, bottom + top]
    size[0] = max(size[0], 0.75 * longest)
    figure.set_size_inches(*size)
    axes.set_position((*(([left, bottom] - low * side) / size), *(side / size)))


def bar_axes(figure: Figure) -> Axes:
    """Axes for a colour bar at the right of a view in space."""
    width, height = figure.get_size_inches()
    return figure.add_axes(
        (1 - 0.9 / width, SPACE_MARGINS[2] / height, 0.13 / width, 1 - sum(SPACE_MARGINS[2:]) / height)
    )
