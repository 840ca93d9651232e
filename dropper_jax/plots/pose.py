"""Snapshot: one pose, how it got there, and its tensions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from dropper_jax.plots import style, view
from dropper_jax.plots.run import Run

#: Past poses in a snapshot, and the way between two of them as a part of the picture's size.
PAST, STRIDE = 8, 0.07


@style.styled
def snapshot(run: Run, path: str | Path, time: float | None = None) -> Path:
    """The pose at a time [s] (None: the last), links coloured by tension [N], the poses before it, and the first.

    In the x-z plane when the motion is planar, else in space.

    Returns:
        path of the picture; its suffix chooses the format.
    """
    t, positions = run.t, run.positions
    now = len(t) - 1 if time is None else int(np.argmin(np.abs(t - time)))
    flat = view.planar(positions)
    past = _past(positions, now)
    limits = view.box(positions[[0, *past, now]])
    figure = style.new_figure(*view.figure_size(limits, flat))
    axes = (view.flat_axes if flat else view.space_axes)(figure, 111, limits)

    def draw(nodes: np.ndarray, *args: Any, **kwargs: Any) -> None:
        axes.plot(*(nodes[:, [0, 2]] if flat else nodes).T, *args, **kwargs)

    for age, index in enumerate(reversed(past), start=1):
        draw(positions[index], color=style.FAINT, lw=1.0, alpha=0.6 * (1 - age / (PAST + 1)))
    if now > 0:
        draw(positions[0], color=style.CYCLE[0], lw=1.2, ls=(0, (4, 3)), label=f"start, t = {t[0]:g} s")
    links = _bold_links(axes, run, positions[now], t[now], flat)
    draw(positions[now], ls="", marker="o", ms=4, mfc="white", mec=style.DARK, mew=1.0, label=f"t = {t[now]:.4g} s")
    held = view.fixed_ends(positions)
    draw(held, ls="", marker="s", ms=7, mfc=style.DARK, mec="white", label="held end")
    figure.colorbar(links, ax=axes, label="tension [N]", shrink=0.75, pad=0.03 if flat else 0.1)
    figure.legend(loc="outside lower left", ncols=3, handletextpad=0.5, columnspacing=1.2)
    style.title(figure, run, "pose and tensions")
    return style.save(figure, path)


def _bold_links(axes: Axes, run: Run, nodes: np.ndarray, time: float, flat: bool) -> ScalarMappable:
    """Links of one pose coloured by their tension at the nearest time known."""
    tension = run.tension[np.argmin(np.abs(run.t_tension - time))]
    segments = np.stack([nodes[:-1], nodes[1:]], axis=1)
    look = {
        "array": tension,
        "cmap": style.tension_map(),
        "norm": style.tension_norm(tension),
        "linewidths": 4.0,
        "capstyle": "round",
    }
    links = LineCollection(segments[..., [0, 2]], **look) if flat else Line3DCollection(segments, **look)
    axes.add_collection(links, **({"autolim": False} if flat else {}))
    return links


def _past(positions: np.ndarray, now: int) -> list[int]:
    """Samples before `now`, a given way apart, so that a picture does not depend on the output interval."""
    if now == 0:
        return []
    way = np.abs(np.diff(positions[: now + 1], axis=0)).max(axis=(1, 2))
    back = np.cumsum(way[::-1])
    marks = STRIDE * view.size(positions) * np.arange(1, PAST + 1)
    steps = np.searchsorted(back, marks[marks <= back[-1]]) + 1
    return [now - int(step) for step in steps[::-1]]
