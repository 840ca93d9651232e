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
from dropper_jax.plots.run import Run

#: More links than this are drawn as a map over time and link (traces) or thinned out (grid).
MOST = 12

Columns = list[tuple[str, np.ndarray]]


def traces(run: Run, path: str | Path, what: str, t: np.ndarray, columns: Columns) -> Path:
    """Quantities (label with unit, values (k, n)) against time (k,): a row per link, a column per quantity.

    The time axis spans the run, whichever times the values belong to.
    """
    links = columns[0][1].shape[1]
    figure = (_map if links > MOST else _stack)(t, columns, run)
    style.title(figure, run, what)
    return style.save(figure, path)


def _stack(t: np.ndarray, columns: Columns, run: Run) -> Figure:
    """A panel per link and quantity."""
    links = columns[0][1].shape[1]
    figure = style.new_figure(8.5, max(3.2, 1.3 + 0.95 * links))
    grid = figure.subplots(links, len(columns), sharex=True, squeeze=False)
    for column, (label, values) in enumerate(columns):
        for link, axes in enumerate(grid[:, column]):
            axes.plot(t, values[:, link], color=style.CYCLE[column], lw=0.9, marker=style.marker(t), ms=4)
            style.widen(values[:, link], axes.set_ylim)
            axes.yaxis.set_major_locator(MaxNLocator(3))
            if column == 0:
                axes.set_ylabel(run.labels[link], rotation=0, ha="right", va="center")
        grid[0, column].set_title(label, loc="left")
        style.time_axis(grid[-1, column], run.t)
    figure.align_ylabels()
    return figure


def _map(t: np.ndarray, columns: Columns, run: Run) -> Figure:
    """A picture per quantity, links against time, colours for values."""
    links = columns[0][1].shape[1]
    figure = style.new_figure(8.5, 1.0 + 3.0 * len(columns))
    edges = np.concatenate([[t[0]], 0.5 * (t[1:] + t[:-1]), [t[-1]]]) if len(t) > 1 else np.array([t[0], t[0] + 1.0])
    for axes, (label, values) in zip(figure.subplots(len(columns), 1, squeeze=False)[:, 0], columns, strict=True):
        image = axes.pcolormesh(edges, np.arange(links + 1) + 0.5, values.T, cmap="viridis", rasterized=True)
        figure.colorbar(image, ax=axes, label=label, pad=0.02)
        _link_axis(axes, run)
        axes.invert_yaxis()
        axes.grid(False)
        style.time_axis(axes, run.t)
    return figure


def _link_axis(axes: Axes, run: Run) -> None:
    """Numbers of the links; of several lines their names, each in the middle of its links, and edges between them."""
    if len(run.lines) == 1:
        axes.set_ylabel("link")
        axes.yaxis.set_major_locator(MaxNLocator(8, integer=True))
        return
    for line in run.whole[1:]:
        axes.axhline(line.links.start + 0.5, color="white", lw=1.0)
    shown = run.whole[:: math.ceil(len(run.whole) / MOST)]
    axes.set_yticks([0.5 * (line.links.start + line.links.stop + 1) for line in shown], [line.name for line in shown])


def grid(
    run: Run,
    path: str | Path,
    what: str,
    links: int,
    draw: Callable[[Axes, int], None],
    labels: tuple[str, str],
    share: bool,
) -> Path:
    """A panel per link, drawn by `draw(axes, link)`; `labels` of both axes with units; `share` them or not."""
    chosen = np.unique(np.linspace(0, links - 1, min(links, MOST)).round().astype(int))
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
    style.title(figure, run, what)
    return style.save(figure, path)
