"""Pictures of a report: tensions along the lines, loads of fixed points, fatigue, watch circles, maxima of runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from dropper_jax.base.read import Table
from dropper_jax.evaluation.extremes import Gumbel
from dropper_jax.evaluation.record import Record
from dropper_jax.evaluation.tension import load_extremes, point_load
from dropper_jax.plots import style
from dropper_jax.plots.panels import DASHES, Curve, hides
from dropper_jax.plots.run import readable
from dropper_jax.plots.style import force_unit
from dropper_jax.report.sections import largest, load_of_anchor

#: Maximum number of lines, anchors or points in one picture, each with its own colour; of more, those with the largest
#: load or motion.
MOST = len(style.CYCLE)
BAND = "#DCEBF5"
INNER = "#56B4E9"


@style.plot_style()
def draw_run(part: Record, found: Table, folder: Path) -> dict[str, Path]:
    """All pictures for the sections of a run, by name."""
    sections = {
        "tension_range": (_tension_range, found["tension"]),
        "anchors": (_anchors, found["anchors"]),
        "fatigue": (_fatigue, found["fatigue"]),
        "watch_circle": (_watch, found["watch_circle"]),
        "along": (_along, found["acceleration"]),
    }
    rows = {}
    for name, (draw, values) in sections.items():
        if isinstance(values, list) and values:
            rows[name] = draw(part, found, folder)
    return rows


def _finish(
    figure: Figure, part: Record, what: str, shown: Sequence[object], every: Sequence[object], path: Path
) -> Path:
    """Write the picture; its title has the numbers of items if some are not shown."""
    if len(shown) == len(every):
        more = ""
    else:
        more = f", {len(shown)} of {len(every)} (the largest)"
    return style.finish(figure, readable(part.solution), what + more, path)


def _panels(count: int, height: float) -> tuple[Figure, np.ndarray]:
    """One panel per item, in two columns for four or more."""
    columns = 1 if count < 4 else 2
    rows = -(-count // columns)
    figure = style.new_figure(7.5 if columns == 1 else 11.25, 0.9 + height * rows)
    return figure, style.panels(figure, count, columns)


def _tension_range(part: Record, found: Table, folder: Path) -> Path:
    """Minimum, mean, maximum tension and percentiles against arc length, and the breaking load if it is close."""
    lines = largest(found["tension"], lambda line: line["largest"]["n"], MOST)
    figure, panels = _panels(len(lines), 3.0)
    unit, scale = force_unit([line["largest"]["n"] for line in lines])
    for axes, line in zip(panels, lines, strict=True):
        s = np.asarray(line["arc_length_m"])
        percentiles = line["percentiles_n"]
        mark: Table = {}
        if len(s) <= 60:
            mark = {"marker": "o", "ms": 3}
        axes.fill_between(s, line["min_n"] / scale, line["max_n"] / scale, color=BAND, label="minimum to maximum")
        for low, high, shade in ((5, 95, 0.35), (25, 75, 0.6)):
            band = (percentiles[str(low)] / scale, percentiles[str(high)] / scale)
            axes.fill_between(s, *band, color=INNER, alpha=shade, lw=0, label=f"{low} to {high} %")
        axes.plot(s, line["max_n"] / scale, color=style.SECOND, lw=1.0, label="maximum", **mark)
        axes.plot(s, line["mean_n"] / scale, color=style.DARK, label="mean", **mark)
        used = line["utilisation"]
        if used is not None and used["largest"] > 0.3:
            axes.axhline(used["breaking_load_n"] / scale, color=style.ALERT, lw=1.0, ls="--", label="breaking load")
        axes.set(
            xlabel="unstretched arc length [m]", ylabel=f"tension [{unit}]", ylim=(min(0.0, axes.get_ylim()[0]), None)
        )
        axes.margins(x=0.01)
        axes.set_title(line["line"], loc="left")
    style.share_scales(panels)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower left", ncols=5, columnspacing=1.0)
    return _finish(figure, part, "tension range", lines, found["tension"], folder / "tension_range.png")


def _anchors(part: Record, found: Table, folder: Path) -> Path:
    """Horizontal and vertical load of each fixed point against time."""
    anchors = largest(found["anchors"], load_of_anchor, MOST)
    figure, panels = _panels(len(anchors), 2.6)
    unit, scale = force_unit([anchor["total_n"]["max"] for anchor in anchors])
    peaks = load_extremes(part)
    for axes, anchor in zip(panels, anchors, strict=True):
        load = point_load(part, anchor["point"])
        curves = {"horizontal": np.hypot(load[:, 0], load[:, 1]), "vertical, upwards": load[:, 2]}
        for i, (colour, (label, values)) in enumerate(zip(style.CYCLE, curves.items(), strict=False)):
            low, high = (a[:, i] / scale for a in peaks[anchor["point"]][:2])
            axes.fill_between(part.t_tension, low, high, color=colour, alpha=0.28, lw=0)
            axes.plot(part.t_tension, values / scale, color=colour, lw=0.9, label=label)
        axes.axhline(0.0, color=style.FAINT, lw=0.7)
        axes.set_ylabel(f"load [{unit}]")
        held = anchor["holding"]
        if held is None:
            used = ""
        else:
            used = f", maximum utilisation {held['utilisation']['max']:.2f}"
        axes.set_title(anchor["point"] + used, loc="left")
        style.time_axis(axes, part.t)
    style.share_scales(panels)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower left", ncols=2)
    return _finish(figure, part, "loads of the fixed points", anchors, found["anchors"], folder / "anchors.png")


def _fatigue(part: Record, found: Table, folder: Path) -> Path:
    """Equivalent range along each line, and the damage per year if there is a breaking load."""
    whole = found["fatigue"]
    lines = largest(whole, lambda line: max(line["equivalent_range_n"]), MOST)
    damaged = all(line["damage"] is not None for line in lines)
    figure = style.new_figure(7.5, 5.6 if damaged else 3.4)
    panels = style.panels(figure, 1 + damaged, sharex=True)
    unit, scale = force_unit(np.concatenate([line["equivalent_range_n"] for line in lines]))
    per_year = {}
    for line in lines:
        if line.get("largest_damage"):
            per_year[line["line"]] = line["damage_per_year"] / line["largest_damage"]
    for colour, line in zip(style.CYCLE, lines, strict=False):
        s = line["arc_length_m"]
        panels[0].plot(s, np.asarray(line["equivalent_range_n"]) / scale, "o-", ms=3, color=colour, label=line["line"])
        if damaged:
            panels[1].plot(s, np.array(line["damage"]) * per_year.get(line["line"], 0.0), "o-", ms=3, color=colour)
    for axes, label in zip(panels, (f"equivalent range [{unit}]", "damage per year [-]"), strict=False):
        axes.set(ylabel=label, ylim=(0, None))
    panels[-1].set_xlabel("unstretched arc length [m]")
    if len(lines) > 1:
        figure.legend(loc="outside lower left", ncols=4)
    return _finish(figure, part, "fatigue along the lines", lines, whole, folder / "fatigue.png")


def _watch(part: Record, found: Table, folder: Path) -> Path:
    """Plan view of each moving point about its mean position, with its watch circle, and its z over time."""
    points = largest(found["watch_circle"], lambda point: point["radius_max_m"], MOST)
    columns = -(-len(points) // 2)
    figure = style.new_figure(4.0 + 2.4 * columns, 4.6)
    left, right = figure.subfigures(1, 2, width_ratios=(2.4 * columns, 4.0))
    plans = left.subplots(1 if len(points) == 1 else 2, columns, squeeze=False).ravel()
    height = right.subplots()
    widest = max(p["radius_max_m"] for p in points) or 1.0
    for plan in plans[len(points) :]:
        plan.set_visible(False)
    for colour, point, plan in zip(style.CYCLE, points, plans, strict=False):
        path = part.point(point["point"])
        about = path - point["mean_m"]
        plan.plot(about[:, 0], about[:, 1], color=colour, lw=0.8)
        plan.add_patch(Circle((0, 0), point["radius_max_m"], fill=False, ec=colour, lw=0.9, ls="--"))
        if point["static_m"] is not None:
            offset = np.asarray(point["static_m"]) - point["mean_m"]
            plan.plot(*offset[:2], "x", color=colour, ms=7)
            widest = max(widest, *np.abs(offset[:2]))
        height.plot(part.t, path[:, 2], color=colour, lw=0.9, label=point["point"])
    for plan, point in zip(plans, points, strict=False):
        plan.plot(0, 0, "+", color=style.DARK, ms=9)
        plan.set(xlim=(-1.1 * widest, 1.1 * widest), ylim=(-1.1 * widest, 1.1 * widest), aspect="equal")
        plan.set_title(point["point"], loc="left", fontsize=9)
    left.supxlabel("x from the mean [m]; + mean, x static, dashed: maximum radius", fontsize=9)
    left.supylabel("y from the mean [m]", fontsize=9)
    height.set_ylabel("z [m]")
    style.time_axis(height, part.t)
    height.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
    return _finish(figure, part, "watch circles", points, found["watch_circle"], folder / "watch_circle.png")


#: Lines of a section, a key of each, and the factor on its values.
Section = tuple[list[Table], str, float]


def _along(part: Record, found: Table, folder: Path) -> Path:
    """Fraction of time under water and on the seabed, and accelerations, against arc length."""
    sections = {
        "under water\n[% of time]": (found["submergence"].get("lines"), "share_under_water", 100.0),
        "on the seabed\n[% of time]": (
            found["seabed"] if isinstance(found["seabed"], list) else None,
            "share_of_time",
            100.0,
        ),
        "acceleration\n99 % [m/s²]": (found["acceleration"], "p99_m_per_s2", 1.0),
        "slack\n[% of time]": (found["snap"], "slack_share", 100.0),
    }
    kept = largest(range(len(found["acceleration"])), lambda i: found["acceleration"][i]["largest_m_per_s2"], MOST)
    there: dict[str, Section] = {}
    for label, (lines, key, scale) in sections.items():
        if lines is not None:
            there[label] = lines, key, scale
    flat = {label: _constant(section, kept) for label, section in there.items()}
    drawn = {label: section for label, section in there.items() if flat[label] is None}
    if not drawn:
        drawn = {label: section for label, section in there.items() if section[2] != 100.0}
    same = [f"{label.split(chr(10))[0]} {flat[label]:g} % of the time" for label in there if label not in drawn]
    figure = style.new_figure(7.5, 1.0 + 0.25 * bool(same) + 1.7 * len(drawn))
    for axes, (label, (lines, key, scale)) in zip(
        style.panels(figure, len(drawn), sharex=True), drawn.items(), strict=True
    ):
        curves = []
        for i in kept:
            curves.append(
                Curve(lines[i]["line"], np.asarray(lines[i]["arc_length_m"]), scale * np.asarray(lines[i][key]))
            )
        for index, (colour, curve) in enumerate(zip(style.CYCLE, curves, strict=False)):
            dashes = DASHES if hides(curves, index) else "-"
            axes.plot(curve.t, curve.values, marker="o", ls=dashes, ms=3, color=colour, label=curve.name)
        if scale == 100.0:
            ylim = (-4, 104)
        else:
            ylim = (0, None)
        axes.set(ylabel=label, ylim=ylim)
    figure.axes[-1].set_xlabel("unstretched arc length [m]")
    if len(kept) > 1:
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower left", ncols=4)
    if same:  # a constant fraction is given as text instead of a panel
        figure.axes[0].set_title("everywhere: " + ", ".join(same), loc="left", fontsize=9)
    return _finish(figure, part, "along the lines", kept, found["acceleration"], folder / "along.png")


def _constant(section: Section, columns: list[int]) -> float | None:
    """The value of a fraction [%] that is constant along the lines; None if it varies or is not a fraction."""
    lines, key, scale = section
    values = scale * np.concatenate([np.atleast_1d(np.asarray(lines[i][key], float)) for i in columns])
    if scale == 100.0 and np.ptp(values) == 0:
        return float(values[0])
    return None


@style.plot_style()
def draw_extremes(extremes: Table, folder: Path) -> Path:
    """Maxima of the runs on Gumbel paper, the fit, and the storm's 90th percentile with its interval."""
    names = [name for name, one in extremes.items() if "skipped" not in one]
    names = largest(names, lambda name: extremes[name]["gumbel_mode"], MOST)
    figure, panels = _panels(len(names), 3.0)
    unit, scale = force_unit([extremes[name]["percentile_90"] for name in names])
    for axes, name in zip(panels, names, strict=True):
        one = extremes[name]
        fit = Gumbel(one["gumbel_mode"], one["gumbel_scale"])
        n = one["runs"]
        plotting_position = (np.arange(n) + 0.56) / (n + 0.12)  # Gringorten's plotting position of a Gumbel sample
        axes.plot(
            -np.log(-np.log(plotting_position)), np.sort(one["maxima"]) / scale, "o", color=style.DARK, label="runs"
        )
        at = np.log(one["extrapolated"]) - np.log(-np.log(0.9))
        reduced = np.array([-1.5, max(at, 3.0)])
        axes.plot(reduced, (fit.mode + fit.scale * reduced) / scale, color=style.FIRST, label="Gumbel fit")
        low, high = (x / scale for x in one["percentile_90_interval"])
        axes.plot([at, at], [low, high], color=style.SECOND, lw=2.5, label="storm, 90th percentile and interval")
        axes.plot(at, one["percentile_90"] / scale, "D", color=style.SECOND)
        axes.set(xlabel="reduced variate, -log(-log P) [-]", ylabel=f"largest [{unit}]")
        axes.set_title(name, loc="left")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower left", ncols=3)
    style.title(figure, "maxima of the runs and of a storm")
    return style.save(figure, folder / "extremes.png")
