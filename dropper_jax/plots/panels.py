"""Many links in one picture: stacked traces, a grid of panels, or a map when there are too many links for either."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dropper_jax.base.records import names_of
from dropper_jax.plots import figures, marks, scales, style
from dropper_jax.plots.movement import ANGLE_ROUNDING, changing, chosen_links
from dropper_jax.plots.run import Run
from dropper_jax.plots.style import CYCLE, FAINT, FIRST

#: Maximum number of links with a trace; more are drawn as a map over time and link (traces) or thinned out (grid).
MAX_TRACES = 12

Columns = list[tuple[str, np.ndarray]]


def traces(run: Run, path: str | Path, what: str, columns: Columns) -> Path:
    """Angles of links (label with unit, values (k, n)) against time: a row per link, a column per quantity.

    Links at rest have no panel, but are listed. If no link moves, the values are drawn along the links. A map of many
    links shows the deviation from their means, since the means differ by more than the motion.
    """
    t = run.t
    links = len(run.labels)
    moving = changing((values for _, values in columns), ANGLE_ROUNDING)
    if len(t) == 1:
        moving[:] = True
    if not moving.any():
        return constants(run, path, what, columns)
    if links > MAX_TRACES:
        return figures.finish(_map(columns, run), run, what, path)
    still = [label for label, moves in zip(run.labels, moving, strict=True) if not moves]
    if still:
        what = f"{what} ({', '.join(still)}: at rest)"
    return figures.finish(_stack(columns, run, np.flatnonzero(moving)), run, what, path)


def constants(run: Run, path: str | Path, what: str, columns: Columns) -> Path:
    """Constant values, along the links; of several lines each under its name."""
    figure = figures.new_figure(8.5, 0.9 + 2.4 * len(columns))
    marked = "-o"
    if len(run.labels) > 60:
        marked = "-"
    for axes, (label, values) in zip(figures.panels(figure, len(columns)), columns, strict=True):
        for line in run.written_lines:
            link = 1 + np.arange(line.links.start, line.links.stop)
            axes.plot(link, values[-1, line.links], marked, color=FIRST, ms=4)
        axes.set_ylabel(label)
        scales.widen(values[-1], axes.set_ylim)
        _link_axis(axes, run, "x")
    return figures.finish(figure, run, f"{what}, from start to end", path)


def _stack(columns: Columns, run: Run, links: np.ndarray) -> Figure:
    """A panel per link and quantity."""
    figure = figures.new_figure(8.5, max(3.2, 1.3 + 0.95 * len(links)))
    grid = figure.subplots(len(links), len(columns), sharex=True, squeeze=False)
    for colour, own, (label, values) in zip(CYCLE, grid.T, columns, strict=False):
        for link, axes in zip(links, own, strict=True):
            axes.plot(run.t, values[:, link], color=colour, lw=0.9, marker=marks.marker(run.t), ms=4)
            scales.widen(values[:, link], axes.set_ylim)
            axes.yaxis.set_major_locator(MaxNLocator(3))
        own[0].set_title(label, loc="left")
        scales.time_axis(own[-1], run.t)
    for link, axes in zip(links, grid[:, 0], strict=True):
        axes.set_ylabel(run.labels[link], rotation=0, ha="right", va="center")
    figure.align_ylabels()
    return figure


def _map(columns: Columns, run: Run) -> Figure:
    """A picture per quantity, links against time, with colours for the deviation from the mean."""
    t = run.t
    links = np.arange(len(run.labels) + 1) + 0.5
    figure = figures.new_figure(8.5, 1.0 + 3.0 * len(columns))
    edges = np.array([t[0], t[0] + 1.0])
    if len(t) > 1:
        edges = np.concatenate([t[:1], 0.5 * (t[1:] + t[:-1]), t[-1:]])
    for axes, (label, values) in zip(figures.panels(figure, len(columns)), columns, strict=True):
        values = values - values.mean(axis=0)
        half = np.percentile(np.abs(values), 99.5) or 1.0
        look = {"cmap": "RdBu_r", "vmin": -half, "vmax": half}
        image = axes.pcolormesh(edges, links, values.T, rasterized=True, **look)
        figure.colorbar(image, ax=axes, label=label.replace(" [", " from its mean ["), pad=0.02)
        _link_axis(axes, run, "y")
        axes.invert_yaxis()
        axes.grid(False)
        scales.time_axis(axes, t)
    return figure


#: Maximum number of lines that are named along an axis, in smaller letters than up to `MAX_TRACES`.
MAX_NAMES = 30


def _link_axis(axes: Axes, run: Run, letter: Literal["x", "y"]) -> None:
    """Numbers of the links; of several lines their names, each in the middle of its links, and edges between them."""
    lines = run.written_lines
    axis = {"x": axes.xaxis, "y": axes.yaxis}[letter]
    if len(lines) == 1:
        axis.set_label_text("link")
        axis.set_major_locator(MaxNLocator(8, integer=True))
        return
    shown = lines[:: math.ceil(len(lines) / MAX_NAMES)]
    label_size = 9 if len(shown) <= MAX_TRACES else 6
    axes.tick_params(axis=letter, labelsize=label_size)
    axis.set_ticks([0.5 * (line.links.start + line.links.stop + 1) for line in shown], names_of(shown))
    edges = [line.links.start + 0.5 for line in lines[1:]]
    if letter == "y":
        axes.hlines(edges, 0.0, 1.0, transform=axes.get_yaxis_transform(), color="white", lw=1.0)
    else:
        axes.vlines(edges, 0.0, 1.0, transform=axes.get_xaxis_transform(), color=style.LIGHT, lw=1.0)
        axes.tick_params(axis="x", rotation=45)
        axes.grid(False, axis="x")


def grid(
    run: Run,
    path: str | Path,
    what: str,
    draw: Callable[[Axes, int], None],
    labels: tuple[str, str],
    share: bool,
) -> Path:
    """A panel for each link that moves, drawn by `draw(axes, link)`; `labels` of the axes, which panels may `share`."""
    chosen = chosen_links(run, MAX_TRACES)
    count = len(chosen)
    if count == 0:
        figure = figures.new_figure(6.0, 2.0)
        figure.text(0.5, 0.45, f"no link turns by more than {ANGLE_ROUNDING:g} rad", ha="center", color=FAINT)
        return figures.finish(figure, run, what, path)
    # A little wider than high: 7 links make 2 rows of 4, 9 make 3 of 3.
    rows = max(1, round(0.85 * math.sqrt(count)))
    columns = math.ceil(count / rows)
    size = (max(2.9 * columns + 0.3, 6.0), 2.4 * rows + 0.9)
    if count == 1:
        size = (6.0, 4.5)
    figure = figures.new_figure(*size)
    panels = figures.panels(figure, count, columns, sharex=share, sharey=share)
    for axes, link in zip(panels, chosen, strict=True):
        draw(axes, int(link))
        axes.set_title(run.labels[link], loc="left")
    figures.outer_labels(panels, columns, *labels)
    names = panels[0].get_legend_handles_labels()[1]
    if len(names) > 1:
        figures.legend_below(figure, panels[0], len(names))
    return figures.finish(figure, run, what, path)
