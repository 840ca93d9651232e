"""Rigid bodies in pictures: outlines of their cylinders and spheres at their attitude, and their motion over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from dropper_jax.base.constants import DEGREE
from dropper_jax.plots import style
from dropper_jax.plots.run import Run
from dropper_jax.plots.shapes import SIDES, Bodies

COLOUR, EDGE = style.CYCLE[4], "#A87400"


def draw_bodies(axes: Axes, bodies: Bodies | None, index: int, flat: bool, axis: int = 0, grow: bool = False) -> None:
    """Bodies at a sample: their outlines in the plane of x (0) or y (1) and z, or their faces in space.

    With `grow` the limits of the axes are extended to include them.
    """
    if bodies is None or not bodies.shapes:
        return
    look = {"facecolors": COLOUR, "edgecolors": style.DARK, "linewidths": 0.8}
    if flat:
        outlines = bodies.outlines(index, lambda positions: positions[:, [axis, 2]])
        axes.add_collection(PolyCollection(outlines, zorder=2.5, **look), autolim=grow)
        return
    faces = [face for rings in bodies.rings(index) for face in _faces(rings)]
    axes.add_collection(Poly3DCollection(faces, facecolors=COLOUR, edgecolors=EDGE, linewidths=0.15))


def _faces(rings: np.ndarray) -> list[np.ndarray]:
    """Sides between rings, and both ends."""
    found = [rings[0], rings[-1]]
    for low, high in zip(rings[:-1], rings[1:], strict=True):
        found += [np.stack([low[i - 1], low[i], high[i], high[i - 1]]) for i in range(SIDES)]
    return found


@style.with_style
def body_motion(run: Run, path: str | Path) -> Path:
    """Heave [m] and displacement [m], roll and pitch [deg] of each body against time.

    Returns:
        path of the picture; its suffix chooses the format.
    """
    bodies = run.bodies
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
    panels[0].set_ylabel("displacement [m]")
    panels[1].set_ylabel("heave [m]")
    panels[2].set_ylabel("pitch, roll dashed [deg]")
    if len(bodies.names) > 1:
        panels[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2)
    style.time_axis(panels[2], run.t)
    style.title(figure, run, "motion of the bodies")
    return style.save(figure, path)
