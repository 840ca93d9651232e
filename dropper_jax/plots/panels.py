"""Many links in one picture: stacked traces, a grid of panels, or a map when there are too many for either."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dropper_jax.plots import style
from dropper_jax.plots.run import ANGLE, Run, changing

#: Maximum number of links with a trace; more are drawn as a map over time and link (traces) or thinned out (grid).
MOST = 12

Columns = list[tuple[str, np.ndarray]]


def traces(
    run: Run,
    path: str | Path,
    what: str,
    t: np.ndarray,
    columns: Columns,
    threshold: float = 0.0,
    centred: bool = False,
) -> Path:
    """Quantities (label with unit, values (k, n)) against time (k,): a row per link, a column per quantity.

    The time axis spans the run for all quantities. Links whose values change by at most `threshold` have no panel, but
    are listed. If no link changes, the values are drawn along the links. `centred`: a map of many links shows the
    deviation from their means, since the means differ by more than the motion.
    """
    links = columns[0][1].shape[1]
    kept = np.flatnonzero(changing([values for _, values in columns], threshold))
    if len(t) > 1 and not len(kept):
        figure = _along(columns, run)
        what = f"{what}, from start to end"
    elif links > MOST:
        figure = _map(t, columns, run, centred)
    else:
        kept = kept if len(t) > 1 else np.arange(links)
        figure = _stack(t, columns, run, kept)
        if len(kept) < links:
            what = f"{what} ({', '.join(run.labels[j] for j in range(links) if j not in kept)}: at rest)"
    return style.finish(figure, run, what, path)


def _along(columns: Columns, run: Run) -> Figure:
    """Constant values, along the links; of several lines each under its name."""
    figure = style.new_figure(8.5, 0.9 + 2.4 * len(columns))
    for axes, (label, values) in zip(figure.subplots(len(columns), 1, squeeze=False)[:, 0], columns, strict=True):
        for line in run.written_lines:
            link = 1 + np.arange(line.links.start, line.links.stop)
            axes.plot(link, values[-1, line.links], "-" if len(run.labels) > 60 else "-o", color=style.FIRST, ms=4)
        axes.set_ylabel(label)
        style.widen(values[-1], axes.set_ylim)
        _link_axis(axes, run, "x")
    return figure


def _stack(t: np.ndarray, columns: Columns, run: Run, mask: np.ndarray) -> Figure:
    """A panel per link and quantity."""
    figure = style.new_figure(8.5, max(3.2, 1.3 + 0.95 * len(mask)))
    grid = figure.subplots(len(mask), len(columns), sharex=True, squeeze=False)
    for column, (label, values) in enumerate(columns):
        for link, axes in zip(mask, grid[:, column], strict=True):
            axes.plot(t, values[:, link], color=style.CYCLE[column], lw=0.9, marker=style.marker(t), ms=4)
            style.widen(values[:, link], axes.set_ylim)
            axes.yaxis.set_major_locator(MaxNLocator(3))
            if column == 0:
                axes.set_ylabel(run.labels[link], rotation=0, ha="right", va="center")
        grid[0, column].set_title(label, loc="left")
        style.time_axis(grid[-1, column], run.t)
    figure.align_ylabels()
    return figure


def _map(t: np.ndarray, columns: Columns, run: Run, centred: bool) -> Figure:
    """A picture per quantity, links against time, with colours for values or, if centred, for their deviation from the
    mean."""
    links = columns[0][1].shape[1]
    figure = style.new_figure(8.5, 1.0 + 3.0 * len(columns))
    edges = np.concatenate([[t[0]], 0.5 * (t[1:] + t[:-1]), [t[-1]]]) if len(t) > 1 else np.array([t[0], t[0] + 1.0])
    for axes, (label, values) in zip(figure.subplots(len(columns), 1, squeeze=False)[:, 0], columns, strict=True):
        look = {"cmap": "viridis"}
        if centred:
            values = values - values.mean(axis=0)
            half = float(np.percentile(np.abs(values), 99.5)) or 1.0
            look = {"cmap": "RdBu_r", "vmin": -half, "vmax": half}
            label = label.replace(" [", " from its mean [")
        image = axes.pcolormesh(edges, np.arange(links + 1) + 0.5, values.T, rasterized=True, **look)
        figure.colorbar(image, ax=axes, label=label, pad=0.02)
        _link_axis(axes, run)
        axes.invert_yaxis()
        axes.grid(False)
        style.time_axis(axes, run.t)
    return figure


def _link_axis(axes: Axes, run: Run, letter: str = "y") -> None:
    """Numbers of the links; of several lines their names, each in the middle of its links, and edges between them."""
    axis = {"x": axes.xaxis, "y": axes.yaxis}[letter]
    if len(run.written_lines) == 1:
        axis.set_label_text("link")
        axis.set_major_locator(MaxNLocator(8, integer=True))
        return
    edge, colour = (axes.axhline, "white") if letter == "y" else (axes.axvline, "#E3E5E8")
    for line in run.written_lines[1:]:
        edge(line.links.start + 0.5, color=colour, lw=1.0)
    # maximum number of lines that are named along an axis, in smaller letters than up to `MOST`
    shown = run.written_lines[:: math.ceil(len(run.written_lines) / 30)]
    axes.tick_params(axis=letter, labelsize=9 if len(shown) <= MOST else 6)
    axis.set_ticks([0.5 * (line.links.start + line.links.stop + 1) for line in shown], [line.name for line in shown])
    if letter == "x":
        axes.tick_params(axis="x", rotation=45)
        axes.grid(False, axis="x")


def grid(
    run: Run,
    path: str | Path,
    what: str,
    chosen: np.ndarray,
    draw: Callable[[Axes, int], None],
    labels: tuple[str, str],
    share: bool,
) -> Path:
    """A panel for each chosen link, drawn by `draw(axes, link)`; `labels` of both axes with units; `share` or not."""
    if not len(chosen):
        return _nothing(run, path, what)
    # A little wider than high: 7 links make 2 rows of 4, 9 make 3 of 3.
    rows = max(1, round(0.85 * math.sqrt(len(chosen))))
    columns = math.ceil(len(chosen) / rows)
    width, height = (6.0, 4.5) if len(chosen) == 1 else (2.9 * columns + 0.3, 2.4 * rows + 0.9)
    figure = style.new_figure(max(width, 6.0), height)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=share, sharey=share).ravel()
    for axes, link in zip(panels, chosen, strict=False):
        draw(axes, int(link))
        axes.set_title(run.labels[link], loc="left")
    for axes in panels[len(chosen) :]:
        axes.set_visible(False)
    for index, axes in enumerate(panels[: len(chosen)]):
        if index + columns >= len(chosen):
            axes.set_xlabel(labels[0])
            axes.tick_params(labelbottom=True)
        if index % columns == 0:
            axes.set_ylabel(labels[1])
    handles, names = panels[0].get_legend_handles_labels()
    if len(handles) > 1:
        figure.legend(handles, names, loc="outside lower left", ncols=len(names))
    return style.finish(figure, run, what, path)


def _nothing(run: Run, path: str | Path, what: str) -> Path:
    """A picture with a note that there is no motion to show."""
    figure = style.new_figure(6.0, 2.0)
    figure.text(0.5, 0.45, f"no link turns by more than {ANGLE:g} rad", ha="center", color=style.FAINT)
    return style.finish(figure, run, what, path)
