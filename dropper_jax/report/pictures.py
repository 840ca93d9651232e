"""Pictures of a report: tensions along the lines, loads of fixed points, fatigue, watch circles, maxima of runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.evaluation.record import Record
from dropper_jax.evaluation.tension import load_extremes
from dropper_jax.plots import figures, scales, style
from dropper_jax.plots.run import readable
from dropper_jax.plots.scales import force_unit
from dropper_jax.plots.style import ALERT, CYCLE, DARK, FAINT, FIRST, SECOND
from dropper_jax.plots.tension_along import draw_bands
from dropper_jax.plots.time_panels import Curve, line_style
from dropper_jax.quantities.end_links import point_loads
from dropper_jax.quantities.step_extremes import load_components
from dropper_jax.report.sections import load_of_anchor
from dropper_jax.report.tables import largest

#: Maximum number of lines, anchors or points in one picture, each with its own colour; of more, those with the largest
#: load or motion.
MAX_SERIES = len(CYCLE)
ARC = "unstretched arc length [m]"


def _panels(count: int, height: float) -> tuple[Figure, np.ndarray]:
    """One panel per item, in two columns for four or more."""
    columns = 1 if count < 4 else 2
    width = 7.5 if columns == 1 else 11.25
    rows = -(-count // columns)
    figure = figures.new_figure(width, 0.9 + height * rows)
    return figure, figures.panels(figure, count, columns)


def _tension_range(record: Record, lines: list[Table], found: Table) -> Figure:
    """Minimum, mean, maximum tension and percentiles against arc length, and the breaking load if it is close."""
    figure, panels = _panels(len(lines), 3.0)
    unit, scale = force_unit([line["largest"]["n"] for line in lines])
    for axes, line in zip(panels, lines, strict=True):
        s = line["arc_length_m"]
        percentiles = {int(key): values / scale for key, values in line["percentiles_n"].items()}
        mark: Table = {}
        if len(s) <= 60:
            mark = {"marker": "o", "ms": 3}
        draw_bands(axes, s, (line["min_n"] / scale, line["max_n"] / scale), percentiles)
        axes.plot(s, line["max_n"] / scale, color=SECOND, lw=1.0, label="maximum", **mark)
        axes.plot(s, line["mean_n"] / scale, color=DARK, label="mean", **mark)
        used = line["utilisation"]
        if used is not None and used["largest"] > 0.3:
            axes.axhline(used["breaking_load_n"] / scale, color=ALERT, lw=1.0, ls="--", label="breaking load")
        axes.set(xlabel=ARC, ylabel=f"tension [{unit}]", ylim=(min(0.0, axes.get_ylim()[0]), None))
        axes.margins(x=0.01)
        axes.set_title(line["line"], loc="left")
    scales.share_scales(panels)
    figures.legend_below(figure, panels[0], 5, columnspacing=1.0)
    return figure


def _anchors(record: Record, anchors: list[Table], found: Table) -> Figure:
    """Horizontal and vertical load of each fixed point against time."""
    figure, panels = _panels(len(anchors), 2.6)
    unit, scale = force_unit([anchor["total_n"]["max"] for anchor in anchors])
    peaks = load_extremes(record)
    loads = point_loads(record.motion)
    for axes, anchor in zip(panels, anchors, strict=True):
        values = load_components(loads[anchor["point"]] / scale)
        low, high, *_ = peaks[anchor["point"]]
        for i, name in enumerate(("horizontal", "vertical, upwards")):
            axes.fill_between(record.t_tension, low[:, i] / scale, high[:, i] / scale, color=CYCLE[i], alpha=0.28, lw=0)
            axes.plot(record.t_tension, values[:, i], color=CYCLE[i], lw=0.9, label=name)
        axes.axhline(0.0, color=FAINT, lw=0.7)
        axes.set_ylabel(f"load [{unit}]")
        title = anchor["point"]
        if anchor["holding"] is not None:
            title = f"{title}, maximum utilisation {anchor['holding']['utilisation']['max']:.2f}"
        axes.set_title(title, loc="left")
        scales.time_axis(axes, record.t)
    scales.share_scales(panels)
    figures.legend_below(figure, panels[0], 2)
    return figure


def _fatigue(record: Record, lines: list[Table], found: Table) -> Figure:
    """Equivalent range along each line, and the damage per year if there is a breaking load."""
    damaged = all(line["damage"] is not None for line in lines)
    height = 5.6 if damaged else 3.4
    figure = figures.new_figure(7.5, height)
    panels = figures.panels(figure, 1 + damaged, sharex=True)
    unit, scale = force_unit(np.concatenate([line["equivalent_range_n"] for line in lines]))
    for colour, line in zip(CYCLE, lines, strict=False):
        look = {"marker": "o", "ms": 3, "color": colour}
        s = line["arc_length_m"]
        panels[0].plot(s, np.asarray(line["equivalent_range_n"]) / scale, label=line["line"], **look)
        if damaged:
            per_year = line["damage_per_year"] / (line["largest_damage"] or 1.0)
            panels[1].plot(s, np.asarray(line["damage"]) * per_year, **look)
    for axes, label in zip(panels, (f"equivalent range [{unit}]", "damage per year [-]"), strict=False):
        axes.set(ylabel=label, ylim=(0, None))
    panels[-1].set_xlabel(ARC)
    if len(lines) > 1:
        figures.legend_below(figure, panels[0], 4)
    return figure


def _watch(record: Record, points: list[Table], found: Table) -> Figure:
    """Plan view of each moving point about its mean position, with its watch circle, and its z over time."""
    columns = -(-len(points) // 2)
    figure = figures.new_figure(4.0 + 2.4 * columns, 4.6)
    left, right = figure.subfigures(1, 2, width_ratios=(2.4 * columns, 4.0))
    plans = figures.panels(left, len(points), columns)
    height = right.subplots()
    widest = max(column(points, "radius_max_m")) or 1.0
    for colour, point, plan in zip(CYCLE, points, plans, strict=False):
        path = record.point(point["point"])
        about = path - point["mean_m"]
        plan.plot(about[:, 0], about[:, 1], color=colour, lw=0.8)
        plan.add_patch(Circle((0, 0), point["radius_max_m"], fill=False, ec=colour, lw=0.9, ls="--"))
        if point["static_m"] is not None:
            offset = np.asarray(point["static_m"]) - point["mean_m"]
            plan.plot(*offset[:2], "x", color=colour, ms=7)
            widest = max(widest, *np.abs(offset[:2]))
        height.plot(record.t, path[:, 2], color=colour, lw=0.9, label=point["point"])
        plan.plot(0, 0, "+", color=DARK, ms=9)
        plan.set_title(point["point"], loc="left", fontsize=9)
    limits = (-1.1 * widest, 1.1 * widest)
    for plan in plans:
        plan.set(xlim=limits, ylim=limits, aspect="equal")
    left.supxlabel("x from the mean [m]\n+ mean, x static\ndashed: maximum radius", fontsize=9)
    left.supylabel("y from the mean [m]", fontsize=9)
    height.set_ylabel("z [m]")
    scales.time_axis(height, record.t)
    figures.legend_above(height, 3, "left")
    return figure


def _along(record: Record, lines: list[Table], found: Table) -> Figure:
    """Fraction of time under water and on the seabed, and accelerations, against arc length.

    A constant fraction is given as text instead of a panel.
    """
    drawn = []
    same = []
    for label, rows, key in (
        ("under water", found["submergence"].get("lines"), "share_under_water"),
        ("on the seabed", found["seabed"], "share_of_time"),
        ("acceleration", found["acceleration"], "p99_m_per_s2"),
        ("slack", found["snap"], "slack_share"),
    ):
        if not isinstance(rows, list):
            continue
        by_name = {row["line"]: row for row in rows}
        curves = []
        for line in lines:
            row = by_name[line["line"]]
            curves.append(Curve(line["line"], row["arc_length_m"], np.asarray(row[key], float)))
        values = np.concatenate([curve.values for curve in curves])
        if label == "acceleration":
            drawn.append((curves, 1.0, f"{label}\n99 % [m/s²]", (0, None)))
        elif np.ptp(values) == 0:
            same.append(f"{label} {100.0 * values[0]:g} % of the time")
        else:
            drawn.append((curves, 100.0, f"{label}\n[% of time]", (-4, 104)))
    figure = figures.new_figure(7.5, 1.0 + 0.25 * bool(same) + 1.7 * len(drawn))
    panels = figures.panels(figure, len(drawn), sharex=True)
    for axes, (curves, scale, label, limits) in zip(panels, drawn, strict=True):
        for index, (colour, curve) in enumerate(zip(CYCLE, curves, strict=False)):
            look = {"marker": "o", "ms": 3, "color": colour, "ls": line_style(curves, index)}
            axes.plot(curve.t, scale * curve.values, label=curve.name, **look)
        axes.set(ylabel=label, ylim=limits)
    panels[-1].set_xlabel(ARC)
    if len(lines) > 1:
        figures.legend_below(figure, panels[0], 4)
    if same:
        panels[0].set_title("everywhere: " + ", ".join(same), loc="left", fontsize=9)
    return figure


class Picture(NamedTuple):
    """A picture of the rows of a section: its title, the size by which rows are chosen, and what draws them."""

    section: str
    title: str
    size: Callable[[Table], float]
    draw: Callable[[Record, list[Table], Table], Figure]


PICTURES = {
    "tension_range": Picture("tension", "tension range", lambda line: line["largest"]["n"], _tension_range),
    "anchors": Picture("anchors", "loads of the fixed points", load_of_anchor, _anchors),
    "fatigue": Picture("fatigue", "fatigue along the lines", lambda line: max(line["equivalent_range_n"]), _fatigue),
    "watch_circle": Picture("watch_circle", "watch circles", lambda point: point["radius_max_m"], _watch),
    "along": Picture("acceleration", "along the lines", lambda line: line["largest_m_per_s2"], _along),
}


@style.plot_style()
def draw_run(record: Record, found: Table, folder: Path) -> dict[str, Path]:
    """All pictures for the sections of a run, by name; a title has the numbers of items if some are not shown."""
    files = {}
    for name, picture in PICTURES.items():
        rows = found[picture.section]
        if not isinstance(rows, list) or not rows:
            continue
        shown = largest(rows, picture.size, MAX_SERIES)
        title = picture.title
        if len(shown) < len(rows):
            title = f"{title}, {len(shown)} of {len(rows)} (the largest)"
        figure = picture.draw(record, shown, found)
        files[name] = figures.finish(figure, readable(record.solution), title, folder / f"{name}.png")
    return files


@style.plot_style()
def draw_extremes(extremes: Table, folder: Path) -> Path:
    """Maxima of the runs on Gumbel paper, the fit, and the storm's 90th percentile with its interval."""
    names = [name for name, one in extremes.items() if "skipped" not in one]
    names = largest(names, lambda name: extremes[name]["gumbel_mode"], MAX_SERIES)
    figure, panels = _panels(len(names), 3.0)
    unit, scale = force_unit([extremes[name]["percentile_90"] for name in names])
    for axes, name in zip(panels, names, strict=True):
        one = extremes[name]
        # Gringorten's plotting position of a Gumbel sample
        probability = (np.arange(one["runs"]) + 0.56) / (one["runs"] + 0.12)
        axes.plot(-np.log(-np.log(probability)), np.sort(one["maxima"]) / scale, "o", color=DARK, label="runs")
        at = np.log(one["extrapolated"]) - np.log(-np.log(0.9))
        reduced = np.array([-1.5, max(at, 3.0)])
        fit = one["gumbel_mode"] + one["gumbel_scale"] * reduced
        axes.plot(reduced, fit / scale, color=FIRST, label="Gumbel fit")
        interval = np.asarray(one["percentile_90_interval"]) / scale
        axes.plot([at, at], interval, color=SECOND, lw=2.5, label="storm, 90th percentile and interval")
        axes.plot(at, one["percentile_90"] / scale, "D", color=SECOND)
        axes.set(xlabel="reduced variate, -log(-log P) [-]", ylabel=f"largest [{unit}]")
        axes.set_title(name, loc="left")
    figures.legend_below(figure, panels[0], 3)
    figures.title(figure, "maxima of the runs and of a storm")
    return figures.save(figure, folder / "extremes.png")
