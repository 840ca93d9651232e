"""Snapshot: one configuration, the previous ones, and its tensions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from dropper_jax.plots import figures, marks, style, tension_colours, view
from dropper_jax.plots.run import Run
from dropper_jax.plots.space_axes import bar_axes, space_axes
from dropper_jax.plots.style import CYCLE, DARK, FAINT
from dropper_jax.plots.surroundings import SURFACE, WATER, draw_bed, draw_solids, limits, surface_lines

#: Number of past configurations in a snapshot.
PAST_POSES = 8
#: With more lines than this, only one configuration is drawn, since more could not be distinguished.
MAX_LINES_WITH_PAST = 12


@style.with_style
def snapshot(run: Run, path: str | Path, time: float | None = None) -> Path:
    """The configuration at a time [s] (None: that of the maximum tension), links coloured by tension [N], previous
    configurations, and the first.

    In the x-z plane when the motion is planar, else in space. Tensions are the maxima of their steps if not every step
    is saved.

    Returns:
        path of the picture; its suffix chooses the format.
    """
    positions = run.positions
    now = run.sample(time)
    clock = run.t[now]
    flat = view.planar(positions)
    crowded = len(run.lines) > MAX_LINES_WITH_PAST
    past = [] if crowded else _past(positions, now)
    drawn = limits(run, positions[[0, *past, now]])
    figure, axes, bar = _new_view(drawn, flat)
    columns = [0, 2] if flat else [0, 1, 2]

    def draw(nodes: np.ndarray, **options: Any) -> None:
        axes.plot(*nodes[:, columns].T, **options)

    def draw_lines(index: int, label: str | None = None, **options: Any) -> None:
        for line in run.lines:
            draw(positions[index, line.nodes], label=label, **options)
            label = None

    _surroundings(axes, run, drawn, clock)
    for age, index in enumerate(reversed(past), start=1):
        draw_lines(index, color=FAINT, lw=1.0, alpha=0.6 * (1 - age / (PAST_POSES + 1)))
    if now > 0 and not crowded:
        draw_lines(0, f"start, t = {run.t[0]:g} s", color=CYCLE[0], lw=1.2, ls=(0, (4, 3)))
    links = _bold_links(axes, run, now)
    draw_solids(axes, run, now)
    nodes = positions[now]
    if marks.dot(run) > 0:
        draw(nodes, ls="", marker="o", ms=marks.dot(run), mfc="white", mec=DARK, mew=1.0, label="node")
    draw(nodes[list(run.fixed_nodes)], ls="", marker="s", ms=7, mfc=DARK, mec="white", label="fixed point")
    joints = {*run.joints} - {buoy.node for buoy in run.buoys}
    if joints and not crowded:
        draw(nodes[sorted(joints)], ls="", marker="D", ms=5, mfc=CYCLE[4], mec=DARK, label="free point")
    tension_colours.tension_bar(figure, links, run.max_tension[now], **bar)
    corner = "outside lower left" if flat else "lower left"
    figure.legend(loc=corner, ncols=3, handletextpad=0.5, columnspacing=1.2)
    what = "position and tension"
    if len(run.t) > 1:
        what = f"{what} at t = {clock:.4g} s"
    return figures.finish(figure, run, what, path)


def _new_view(drawn: np.ndarray, flat: bool) -> tuple[Figure, Axes, dict[str, Any]]:
    """A figure of limits (3, 2) [m], its axes in the x-z plane or in space, and the position of its colour bar."""
    width, height = view.figure_size(drawn)
    if flat:
        figure = figures.new_figure(width, height)
        axes = view.flat_axes(figure, drawn)
        return figure, axes, {"ax": axes, "shrink": 0.75, "pad": 0.03}
    figure = figures.new_figure(width, height, layout=None)
    axes = space_axes(figure, drawn)
    return figure, axes, {"cax": bar_axes(figure)}


def _surroundings(axes: Axes, run: Run, drawn: np.ndarray, time: float) -> None:
    """Seabed and water around the drawn positions."""
    draw_bed(axes, run, drawn)
    in_space = isinstance(axes, Axes3D)
    surface = surface_lines(run, drawn, not in_space, np.array([time]))
    if surface is None:
        return
    if in_space:
        axes.add_collection(Line3DCollection(list(surface[0]), colors=SURFACE, linewidths=0.6, alpha=0.6))
        return
    x = surface[0, 0, :, 0]
    z = surface[0, 0, :, 2]
    axes.fill_between(x, drawn[2, 0], z, color=WATER, lw=0, zorder=0.3)
    axes.plot(x, z, color=SURFACE, lw=1.2, zorder=0.6)


def _bold_links(axes: Axes, run: Run, index: int) -> ScalarMappable:
    """Links of a sample coloured by their tension, the maximum of its steps."""
    tension = run.max_tension[index]
    segments = run.segments(run.positions[index])
    look: dict[str, Any] = {
        "array": tension,
        "cmap": tension_colours.tension_map(),
        "norm": tension_colours.tension_norm(tension),
        "capstyle": "round",
        "linewidths": 4.0 * marks.bold(run),
    }
    if isinstance(axes, Axes3D):
        return axes.add_collection(Line3DCollection(segments, **look))
    return axes.add_collection(LineCollection(list(segments[..., [0, 2]]), **look), autolim=False)


#: Displacement between two past configurations as a fraction of the picture's size.
PAST_DISTANCE = 0.07


def _past(positions: np.ndarray, now: int) -> list[int]:
    """Samples before `now` at a given distance, so that a picture does not depend on the output interval."""
    moved = np.abs(np.diff(positions[: now + 1], axis=0)).max(axis=(1, 2))
    back = np.cumsum(moved[::-1])
    distances = PAST_DISTANCE * view.size(positions) * np.arange(1, PAST_POSES + 1)
    steps = np.searchsorted(back, distances[distances <= back.max(initial=0.0)]) + 1
    return (now - steps[::-1]).tolist()
