"""Lines under the surface of the water, seen from two sides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from dropper_jax.load.surface import bed_height
from dropper_jax.plots import figures, marks, style, view
from dropper_jax.plots.run import Run, elevations, sea_of
from dropper_jax.plots.style import DARK, FAINT, SECOND
from dropper_jax.plots.surroundings import BED, SURFACE, WATER, draw_solids

#: Number of points along the surface of a picture.
SURFACE_POINTS = 240
#: Ratio of height to length below which both views of a system are drawn one above the other.
LOW_AND_LONG = 0.35


@style.with_style
def under_surface(run: Run, path: str | Path, time: float | None = None) -> Path:
    """The line [m] and the surface above it at a time [s] (default: that of the maximum tension), seen from two sides.

    What stays in the plane of x and z is seen from one side only.
    """
    sea_of(run)
    index = run.sample(time)
    extent = np.ptp(run.positions[index], axis=0)
    half = 0.55 * max(extent.max(), 1.0)
    low_and_long = extent[2] < LOW_AND_LONG * 2 * half
    sides = 1 if view.planar(run.positions) else 2
    columns = sides
    height = 5.6
    if low_and_long:  # one above the other
        columns = 1
        height = 2.6 * sides + 0.4
    figure = figures.new_figure(9.5, height)
    for axis, axes in enumerate(figures.panels(figure, sides, columns, sharey=True)):
        _side_view(axes, run, index, axis, half)
    figure.axes[0].set_ylabel("z [m]")
    if low_and_long:
        figure.axes[-1].set_ylabel("z [m]")
        figures.legend_below(figure, figure.axes[0], 4)
    else:
        figure.axes[0].legend(loc="upper left", bbox_to_anchor=(0.0, 1.12), ncols=4)
    return figures.finish(figure, run, f"under the surface at t = {run.t[index]:.2f} s", path)


def _side_view(axes: Axes, run: Run, index: int, axis: int, half: float) -> None:
    """Lines, surface and seabed of a sample over x (0) or y (1), up to `half` [m] from the middle of the lines."""
    nodes = run.positions[index]
    low = nodes.min(axis=0)
    high = nodes.max(axis=0)
    middle = 0.5 * (low + high)
    along = np.linspace(middle[axis] - half, middle[axis] + half, SURFACE_POINTS)
    positions = np.tile(middle, (SURFACE_POINTS, 1))
    positions[:, axis] = along
    eta = elevations(run.scene, positions, run.t[index : index + 1])[0]
    bed = bed_height(run.scene, positions)
    if bed is None:
        lowest = max(low[2] - 0.1 * half, -sea_of(run).depth)
    else:
        lowest = low[2] - 0.1 * (high - low)[2]
    axes.fill_between(along, eta, lowest, color=WATER)
    if bed is not None and bed.max() > lowest:
        axes.fill_between(along, np.maximum(bed, lowest), lowest, color=BED, label="seabed")
    axes.plot(along, eta, color=SURFACE, label="surface")
    axes.axhline(0.0, color=FAINT, lw=0.7, ls="--")
    label = "line" if len(run.lines) == 1 else "lines"
    for line in run.lines:
        own = nodes[line.nodes]
        axes.plot(own[:, axis], own[:, 2], "-o", color=DARK, ms=max(marks.dot(run) - 0.5, 0.0), label=label)
        label = None
    ends = nodes[list(run.fixed_nodes)]
    axes.plot(ends[:, axis], ends[:, 2], "s", color=SECOND, ms=6, label="fixed points")
    draw_solids(axes, run, index, axis, grow=True)
    axes.set(xlabel=f"{'xy'[axis]} [m]", xlim=(along[0], along[-1]), ylim=(lowest, None), aspect="equal")
