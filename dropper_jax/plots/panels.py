"""Many links in one picture: stacked traces, a grid of panels, or a map when there are too many for either."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dropper_jax.analysis.spectrum import balance_drift
from dropper_jax.load.scene import Scene
from dropper_jax.plots import style
from dropper_jax.plots.run import ANGLE, TENSION, Run, changing
from dropper_jax.plots.series import Curve, Panel, history
from dropper_jax.plots.style import force_unit
from dropper_jax.run.bends import curvature, held_points, point_load
from dropper_jax.scene import whole_lines

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
    style.title(figure, run, what)
    return style.save(figure, path)


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
    style.title(figure, run, what)
    return style.save(figure, path)


def _nothing(run: Run, path: str | Path, what: str) -> Path:
    """A picture with a note that there is no motion to show."""
    figure = style.new_figure(6.0, 2.0)
    figure.text(0.5, 0.45, f"no link turns by more than {ANGLE:g} rad", ha="center", color=style.FAINT)
    style.title(figure, run, what)
    return style.save(figure, path)


# Energies and tensions over time: the maximum, at the fixed points, at the ends of the lines


@style.with_style
def energy_balance(run: Run, path: str | Path) -> Path:
    """Kinetic and potential energy (above its minimum), minus the work of each contribution, their sum, its drift [J].

    The sum is constant for an exact solution; below it, the absolute drift on a logarithmic axis.
    """
    t, kinetic, work = run.t, run.kinetic, run.work
    potential = run.potential - run.potential.min()
    figure = style.new_figure(8.5, 5.8)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1))
    mark = {"marker": style.marker(t), "ms": 4}
    # The sum is drawn below the others: if there is only one energy, both stay visible.
    upper.plot(t, kinetic + potential - work.sum(axis=1), color=style.DARK, lw=2.4, label="sum", **mark)
    upper.plot(t, kinetic, color=style.CYCLE[0], lw=0.9, label="kinetic", **mark)
    upper.plot(t, potential, color=style.CYCLE[2], lw=0.9, label="potential, above its minimum", **mark)
    for index, name in enumerate(run.work_names):
        colour = style.CYCLE[1:2] + style.CYCLE[3:]
        upper.plot(
            t, -work[:, index], color=colour[index % len(colour)], label=f"minus work, {name.replace('_', ' ')}", **mark
        )
    upper.set_ylabel("energy [J]")
    upper.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.2)
    scale = max(np.abs(kinetic).max(), np.abs(potential).max()) or 1.0
    # drift below this fraction of the maximum energy is rounding: the log axis ends there
    drift = np.maximum(np.abs(balance_drift(run)), 1e-17 * scale)
    lower.semilogy(t, drift, color=style.DARK, lw=0.8, **mark)
    lower.set_ylim(0.5 * drift[1:].min(initial=drift.max()), 3 * drift.max())
    lower.set_ylabel("|drift| [J]")
    style.time_axis(lower, t)
    style.title(figure, run, "energy balance")
    return style.save(figure, path)


@style.with_style
def tension_traces(run: Run, path: str | Path) -> Path:
    """Tension [N or kN] of every link against time (the mean over the step if the scheme gives it)."""
    unit, size = force_unit(run.tension)
    least = TENSION * float(np.nanmax(np.abs(run.tension), initial=0.0)) / size
    columns = [(f"tension [{unit}]", run.tension / size)]
    return traces(run, path, "link tensions", run.t_tension, columns, least)


#: Maximum number of curves in one panel.
MOST_CURVES = 4


@style.plot_style()
def along_lines(scene: Scene, positions: np.ndarray, tension: np.ndarray, path: str | Path) -> Path:
    """Tension [N or kN] and curvature [1/m] of a static pose over the arc length, of the lines with the most tension.

    Args:
        positions: all nodes (nodes, 3) [m]; tension: (n,) [N].
    """
    bent = curvature(scene, positions[None])[0]
    bent[bent == 0.0] = np.nan  # ends, and points that cut a line
    lines = sorted(whole_lines(scene), key=lambda line: -tension[line.links].max())
    unit, size = force_unit(tension)
    figure = style.new_figure(7.5, 4.8)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for i, (colour, line) in enumerate(zip(style.CYCLE, lines[: 2 * MOST_CURVES], strict=False)):
        mark = {"marker": "o", "ms": 2.5, "color": colour, "ls": "--" if i % 2 else "-"}  # equal lines hide each other
        arc = np.concatenate([[0.0], np.cumsum(line.spec.length)])
        upper.plot(arc[1:] - 0.5 * line.spec.length, tension[line.links] / size, label=line.name, **mark)
        lower.plot(arc, bent[line.nodes], **mark)
    upper.set_ylabel(f"tension [{unit}]")
    lower.set(xlabel="unstretched arc length [m]", ylabel="curvature [1/m]")
    upper.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2)
    return style.save(figure, path)


@style.with_style
def tension_history(run: Run, path: str | Path) -> Path:
    """Tension against time [N or kN]: the maximum of all links, the force on fixed points, both ends of lines.

    Of many the most loaded. The shade is the range within a sample if steps adapt to snap loads. A long record is drawn
    as its envelope, with a zoom around its maximum tension.
    """
    kept = slice(_begin(run), None)
    unit, size = force_unit(run.max_tension[kept])
    least = TENSION * float(np.nanmax(np.abs(run.tension[kept]), initial=0.0))
    if len(run.t) > 1 and not changing([run.min_tension[kept], run.max_tension[kept]], least).any():
        return traces(run, path, "tension", run.t_tension, [(f"tension [{unit}]", run.tension[kept] / size)], least)
    found = [_largest(run, unit, size)]
    if run.scene is not None and len(run.written_lines) > 1:
        found.append(_held_points_panel(run, unit, size))
    return history(run, path, "tension", [*found, ends_panel(run)])


def _begin(run: Run) -> int:
    """First sample to draw: the tension at the start belongs to no step."""
    return 1 if len(run.t) > 2 else 0


def _largest(run: Run, unit: str, size: float) -> Panel:
    kept = slice(_begin(run), None)
    largest = run.max_tension[kept]
    link = int(np.unravel_index(np.argmax(np.nan_to_num(largest, nan=-np.inf)), largest.shape)[1])
    curve = Curve("", run.t_tension[kept], largest.max(axis=1) / size, colour=style.DARK)
    return Panel(f"tension [{unit}]", [curve], f"maximum over all links; the highest is in {run.labels[link]}")


def _held_points_panel(run: Run, unit: str, size: float) -> Panel:
    kept = slice(_begin(run), None)
    t, tension = run.t_tension[kept], run.tension[kept]
    loads = {
        name: np.linalg.norm(point_load(run.scene, name, run.t, run.positions, t, tension), axis=1)
        for name in held_points(run.scene)
    }
    names = sorted(loads, key=lambda name: -np.nanmax(loads[name]))[:MOST_CURVES]
    curves = [Curve(name, t, loads[name] / size) for name in names]
    return Panel(f"force [{unit}]", curves, _count_title("force on each fixed point", len(names), len(loads)))


def ends_panel(run: Run) -> Panel:
    """Both ends of one line; of several the more loaded end."""
    kept = slice(_begin(run), None)
    unit, size = force_unit(run.max_tension[kept])
    t = run.t_tension[kept]
    lines = sorted(run.written_lines, key=lambda line: -np.nanmax(run.max_tension[kept, line.links]))[:MOST_CURVES]
    both = len(lines) == 1
    curves = []
    for line in lines:
        ends = (("first link", line.links.start), ("last link", line.links.stop - 1))
        if not both:
            ends = (max(ends, key=lambda end: np.nanmax(run.max_tension[kept, end[1]])),)
        if both and run.scene is not None:
            stops = [line.stops[key] for key in (min(line.stops), max(line.stops))]
            ends = tuple((f"at {stop}", link) for stop, (_, link) in zip(stops, ends, strict=True))
        for name, link in ends:
            values, low, high = (a[kept, link] / size for a in (run.tension, run.min_tension, run.max_tension))
            range_ = (None, None) if run.extremes is None else (low, high)
            curves.append(Curve(name if both else line.name, t, values, *range_))
    title = (
        "ends of the line" if both else _count_title("more loaded end of each line", len(lines), len(run.written_lines))
    )
    return Panel(f"tension [{unit}]", curves, title, zero=True)


def _count_title(what: str, shown: int, total: int) -> str:
    return what if shown == total else f"{what}; {shown} of {total}"
