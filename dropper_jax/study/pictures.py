"""Pictures of the studies and of a scene near equilibrium, in the style of `dropper_jax.plots`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from dropper_jax import plots
from dropper_jax.base.markdown import first_names
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.plots import style, view
from dropper_jax.scene import line_slices
from dropper_jax.statics import Equilibrium
from dropper_jax.statics.modes import Modes


def pose(scene: Scene, found: Equilibrium, path: str | Path) -> Path:
    """The equilibrium, with links coloured by tension [N]."""
    once = np.zeros(1)
    solution = SimpleNamespace(
        scene=scene,
        settings={"integrator": "static pose", "dt": 0.0},
        status=found.status,
        t=once,
        positions=np.asarray(found.positions)[None],
        velocities=np.zeros((1, *np.shape(found.positions))),
        tension=np.asarray(found.tension)[None],
        tension_min=None,
        tension_max=None,
        t_tension=once,
        kinetic=once,
        potential=once,
        work=np.zeros((1, 0)),
        work_names=(),
        lines=line_slices(scene),
        body_position=None,
    )
    return plots.snapshot(solution, path)


#: Ratio of height to length below which the modes are drawn below one another.
LOW_AND_LONG = 0.25
#: Maximum displacement as a fraction of the configuration's size.
SHAPE_SIZE = 0.12


@style.plot_style()
def mode_shapes(scene: Scene, model: Model, found: Equilibrium, modes: Modes, path: str | Path) -> Path:
    """The slowest modes: the equilibrium and both extremes of the motion, in the view with the largest motion."""
    count = min(len(modes.period), 9)
    r = np.asarray(found.state.r)
    ends_of_lines = model.ends(found.state.t)
    rest = np.asarray(found.positions)
    size = view.size(rest)
    low = np.ptp(rest[:, 2]) < LOW_AND_LONG * max(np.ptp(rest[:, 0]), np.ptp(rest[:, 1]))
    columns = 1 if low else min(count, 3)
    figure = style.new_figure(3.6 * columns + (4.4 if low else 0.6), (1.5 if low else 2.9) * -(-count // columns) + 0.8)
    grid = np.atleast_1d(figure.subplots(-(-count // columns), columns, squeeze=False)).ravel()
    for axes in grid[count:]:
        axes.axis("off")
    for i, axes in enumerate(grid[:count]):
        shape = np.asarray(modes.shape[i])
        shape = shape * SHAPE_SIZE * size / max(float(np.abs(shape).max()), np.finfo(float).tiny)
        ends = [np.asarray(model.nodes(r + sign * shape, ends_of_lines)) for sign in (1.0, -1.0)]
        across, up = _plane(rest, ends[0] - rest)
        for line in line_slices(scene):
            for nodes, colour in zip(ends, (style.FIRST, style.SECOND), strict=True):
                axes.plot(*nodes[line.nodes][:, [across, up]].T, color=colour, lw=1.3)
            axes.plot(*rest[line.nodes][:, [across, up]].T, color=style.DARK, lw=0.9, ls=(0, (3, 3)))
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(f"{i + 1}: {modes.period[i]:.3g} s", loc="left", fontsize=9)
        axes.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]")
    return save_titled(figure, f"{scene.name}: slowest modes (dashed: equilibrium; displacements are enlarged)", path)


def _plane(rest: np.ndarray, moved: np.ndarray) -> tuple[int, int]:
    """The two axes with the largest motion and extent: view from the side, the front, or above."""
    share = np.sum(moved**2, axis=0)
    extent = np.ptp(rest, axis=0)
    return max(((0, 2), (1, 2), (0, 1)), key=lambda pair: sum(share[list(pair)]) * np.hypot(*extent[list(pair)]))


@style.plot_style()
def responses(name: str, rows: Sequence[dict[str, Any]], path: str | Path) -> Path:
    """Amplitude, mean and phase of the first link over the period of the waves; dashed, in waves that are 10 %
    higher."""
    figure = style.new_figure(7.5, 6.2)
    panels = figure.subplots(3, 1, sharex=True)
    period = [row["period_s"] for row in rows]
    for axes, key, label in zip(
        panels,
        ("amplitude_rad", "mean_rad", "phase_rad"),
        ("amplitude [rad]", "mean [rad]", "phase [rad]"),
        strict=True,
    ):
        values = np.array([row[key] for row in rows], float)
        axes.plot(period, np.unwrap(values) if key == "phase_rad" else values, label="as in the scene", **marks(0))
        axes.set_ylabel(label)
    more = [row.get("amplitude_10_percent_more") for row in rows]
    if all(value is not None for value in more):
        higher = [row["amplitude_rad"] * (1.0 + value) for row, value in zip(rows, more, strict=True)]
        panels[0].plot(period, higher, label="waves 10 % higher", **marks(1))
        panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)
    panels[-1].set_xlabel("period of the waves [s]")
    figure.align_ylabels()
    return save_titled(figure, f"{name}: angle of the first link in regular waves", path)


@style.plot_style()
def mussels(name: str, rows: Sequence[dict[str, Any]], path: str | Path) -> Path:
    """Layer and wet weight over depth, a curve for each month, a column for each rope.

    Dashes: below the last depth of the table values are constant.
    """
    ropes = list(dict.fromkeys(tuple(row["lines"]) for row in rows))
    months = list(dict.fromkeys(row["month"] for row in rows))
    figure = style.new_figure(max(3.6 * len(ropes), 5.0) + 0.8, 6.4)
    grid = figure.subplots(2, len(ropes), sharey=True, squeeze=False)
    below = 0.2 * max(row["depth_m"] for row in rows) or 1.0
    for column, lines in zip(grid.T, ropes, strict=True):
        for i, month in enumerate(months):
            shown = [row for row in rows if tuple(row["lines"]) == lines and row["month"] == month]
            depth = [row["depth_m"] for row in shown]
            colour = style.tension_map()(0.9 * i / max(len(months) - 1, 1))
            for axes, key, size in zip(column, ("thickness_m", "wet_weight_n_per_m"), (1e3, 1.0), strict=True):
                values = [size * row[key] for row in shown]
                axes.plot(values, depth, "o-", color=colour, ms=3.5, label=f"month {month:g}")
                axes.plot([values[-1]] * 2, [depth[-1], depth[-1] + below], color=colour, ls="--")
        column[0].set_title(first_names(lines, 1), loc="left", fontsize=9)
        for axes in column:
            axes.axvline(0.0, color=style.FAINT, lw=0.7)
        column[0].set_xlabel("layer [mm]")
        column[1].set_xlabel("wet weight [N/m]")
    grid[0, 0].invert_yaxis()
    for axes in grid[:, 0]:
        axes.set_ylabel("depth [m]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper")
    return save_titled(figure, f"{name}: mussels by depth and month", path)


@style.plot_style()
def tide(name: str, rows: Sequence[dict[str, Any]], path: str | Path) -> Path:
    """Current, level, excursion and force on the fixed points through a cycle."""
    figure = style.new_figure(7.5, 6.2)
    water, moved, tension = figure.subplots(3, 1, sharex=True)
    hours = [row["t_s"] / 3600.0 for row in rows]
    water.plot(hours, [row["speed_m_per_s"] for row in rows], label="current [m/s]", **marks(0))
    water.plot(hours, [row["level_m"] for row in rows], label="level [m]", **marks(1))
    moved.plot(hours, [row["displacement_m"] for row in rows], **marks(0))
    moved.set_ylabel("moved [m]")
    for i, point in enumerate(rows[0]["held_load_n"]):
        tension.plot(hours, [np.linalg.norm(row["held_load_n"][point]) / 1e3 for row in rows], label=point, **marks(i))
    tension.set(xlabel="time [h]", ylabel="pull [kN]")
    for axes in (water, tension):
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.2, fontsize=8)
    figure.align_ylabels()
    return save_titled(figure, f"{name}: through the tide", path)


MARKERS = "osD^v<>PX*hp"


def marks(index: int) -> dict[str, Any]:
    """Colour, marker and dash of a series by number, all different."""
    colours = style.CYCLE
    dash = ("-", "--", ":")[index // len(colours) % 3]
    return {"color": colours[index % len(colours)], "marker": MARKERS[index % len(MARKERS)], "ls": dash, "ms": 4}


@style.plot_style()
def work_precision(report: dict[str, Any], path: str | Path) -> Path:
    """RMS angle error against wall time and against the step, and energy drift against the step, log-log."""
    figure = style.new_figure(12.0, 5.4)
    axes = figure.subplots(1, 3)
    rows = [row for row in report["rows"] if row["status"] == "ok"]
    plots = (
        (
            "wall_s_per_simulated_s",
            "rms_angle_error_rad",
            "wall time per simulated second [s]",
            "RMS angle error [rad]",
        ),
        ("dt", "rms_angle_error_rad", "step [s]", "RMS angle error [rad]"),
        ("dt", "energy_drift_j", "step [s]", "energy drift [J]"),
    )
    labels = list(dict.fromkeys(row["label"] for row in rows))
    for (x, y, across, up), panel in zip(plots, axes, strict=True):
        for i, label in enumerate(labels):
            _series(panel, [r for r in rows if r["label"] == label], x, y, label, i)
        panel.set(xscale="log", yscale="log", xlabel=across, ylabel=up)
    for panel in axes[:2]:
        floor = report["reference"]["error_estimate_rad"]
        panel.axhline(floor, color=style.FAINT, lw=0.8, ls=":")
        panel.annotate(
            "error of the reference", (0.02, floor), (0, 2), ("axes fraction", "data"), "offset points", fontsize=7
        )
    _slopes(axes[1], rows)
    handles, names = axes[1].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=5, fontsize=8)
    return save_titled(
        figure, f"{report['scene']}: accuracy against time, first {report['reference']['horizon_s']:.3g} s", path
    )


def _series(axes: Axes, rows: list[dict[str, Any]], x: str, y: str, label: str, index: int) -> None:
    rows = sorted((r for r in rows if (r[y] or 0) > 0), key=lambda r: r["dt"])
    if rows:
        axes.plot([r[x] for r in rows], [r[y] for r in rows], label=label, lw=1.0, **marks(index))


def _slopes(axes: Axes, rows: list[dict[str, Any]]) -> None:
    """Lines of order 1, 2 and 4 to compare with."""
    dts = np.array(sorted({row["dt"] for row in rows}))
    if len(dts) < 2:
        return
    for order, top in ((1, 0.5), (2, 2.0), (4, 0.3)):
        line = top * (dts / dts[-1]) ** order
        axes.plot(dts, line, color=style.FAINT, lw=0.8, zorder=0)
        axes.annotate(
            f"order {order}", (dts[0], line[0]), (3, -8), "data", "offset points", fontsize=7, color=style.FAINT
        )


@style.plot_style()
def convergence(report: dict[str, Any], path: str | Path) -> Path:
    """RMS difference of each link's angles between a step and its half (thesis Fig. 5.4, C.1, C.2)."""
    found = report["convergence"]
    kinds = ["polar"] + (["azimuth"] if any(f["azimuth"] is not None for f in found) else [])
    figure = style.new_figure(4.2 * len(found) + 0.6, 3.4 * len(kinds) + 0.9)
    grid = figure.subplots(len(kinds), len(found), squeeze=False, sharex=True, sharey=True)
    for row, kind in zip(grid, kinds, strict=True):
        for axes, scheme in zip(row, found, strict=True):
            _links(axes, scheme, kind, report.get("links", ()))
        row[0].set_ylabel(f"RMS difference of {kind} angle [rad]")
    for axes in grid[-1]:
        axes.set_xlabel("step [s]")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    handles, names = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=7, fontsize=8)
    return save_titled(figure, f"{report['scene']}: each step against its half", path)


def _links(axes: Axes, scheme: dict[str, Any], kind: str, numbers: Sequence[int]) -> None:
    values = scheme[kind]
    axes.set_title(scheme["label"], loc="left")
    axes.set(xscale="log", yscale="log")
    if values is None:
        return
    for link in range(np.shape(values)[1]):
        label = f"link {numbers[link] if numbers else link + 1}"
        axes.plot(scheme["dts"], np.asarray(values)[:, link], label=label, lw=1.0, **marks(link))
    for dt, status in zip(scheme["dts"], scheme["status"], strict=True):
        if status != "ok":
            axes.axvline(dt, color=style.ALERT, lw=0.8, ls=":")
            axes.annotate(status, (dt, 0.02), (2, 0), ("data", "axes fraction"), "offset points", rotation=90,
                          fontsize=7, color=style.ALERT)  # fmt: skip


@style.plot_style()
def damping(report: dict[str, Any], path: str | Path) -> Path:
    """Equivalent linear damping of each scheme against the step, with what the thesis fitted; failures at the top."""
    found = report["numerical_damping"]
    figure = style.new_figure(8.0, 5.2)
    axes = figure.subplots()
    labels = list(dict.fromkeys(row["label"] for row in found["rows"]))
    for i, label in enumerate(labels):
        _damping_series(axes, [r for r in found["rows"] if r["label"] == label], label, i, len(labels))
    axes.axhline(found["thesis_b_l"], color=style.DARK, lw=0.9, ls=":")
    axes.axvline(0.0065, color=style.DARK, lw=0.9, ls=":")
    axes.annotate(
        "b_l the thesis fitted, at its step", (0.0066, found["thesis_b_l"]), (2, 3), "data", "offset points", fontsize=8
    )
    axes.set(xscale="log", xlabel="step [s]", ylabel="equivalent linear damping [kg/s]")
    axes.set_yscale("symlog", linthresh=1e-6)
    axes.set_ylim(-1e-2, 1.0)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    return save_titled(figure, f"{found['scene']}: numerical damping (below 0: gains; crosses: fails)", path)


def _damping_series(axes: Axes, rows: list[dict[str, Any]], label: str, index: int, count: int) -> None:
    good = [r for r in rows if r["status"] == "ok"]
    bad = [r for r in rows if r["status"] != "ok"]
    look = marks(index)
    axes.plot([r["dt"] for r in good], [r["equivalent_linear_damping"] for r in good], label=label, lw=1.0, **look)
    height = 0.35 * 1.12 ** (index - count / 2)  # a row of crosses per scheme, so that they do not overlap
    axes.plot([r["dt"] for r in bad], [height] * len(bad), ls="", marker="x", ms=5, color=look["color"])


@style.plot_style()
def costs(report: dict[str, Any], path: str | Path) -> Path:
    """Microseconds, operations and bytes per step of the scene without each of its effects, one bar each."""
    rows = report["rows"]
    figure = style.new_figure(11.0, 1.6 + 0.42 * len(rows))
    names = [row["name"] for row in rows]
    parts = (("us_per_step", "microseconds per step"), ("flops", "operations per step"), ("bytes", "bytes per step"))
    for axes, (key, label) in zip(figure.subplots(1, 3, sharey=True), parts, strict=True):
        values = [row[key] or 0.0 for row in rows]
        colours = [style.FIRST if name == "whole scene" else style.FAINT for name in names]
        axes.bar_label(axes.barh(names, values, color=colours), [f"{v:.4g}" for v in values], fontsize=8, padding=2)
        axes.set_xlim(0, 1.25 * max([*values, 1e-9]))
        axes.set_xlabel(label)
        axes.invert_yaxis() if key == "us_per_step" else None
        axes.grid(axis="y", visible=False)
    return save_titled(
        figure, f"{report['scene']}: what each effect costs ({report['integrator']}, {report['solver']})", path
    )


def title(figure: Figure, text: str) -> None:
    figure.suptitle(text, fontsize=12, fontweight="bold", x=0.01, ha="left")


def save_titled(figure: Figure, text: str, path: str | Path) -> Path:
    """Write a figure to a file, with a title."""
    title(figure, text)
    return style.save(figure, path)


@style.plot_style()
def offsets(name: str, rows: Sequence[dict[str, Any]], path: str | Path) -> Path:
    """Restoring force and maximum tension over the offset, a curve for each direction."""
    figure = style.new_figure(9.5, 4.4)
    restoring, tension = figure.subplots(1, 2, sharex=True)
    for i, direction in enumerate(dict.fromkeys(row["direction_deg"] for row in rows)):
        shown = [row for row in rows if row["direction_deg"] == direction and row["status"] == "ok"]
        for axes, key in ((restoring, "restoring_n"), (tension, "max_tension_n")):
            values = [row[key] / 1e3 for row in shown]
            axes.plot([row["distance_m"] for row in shown], values, label=f"{direction:g}", **marks(i))
    restoring.set(xlabel="offset [m]", ylabel="restoring force [kN]")
    tension.set(xlabel="offset [m]", ylabel="maximum tension [kN]")
    handles, labels = restoring.get_legend_handles_labels()
    figure.legend(handles, labels, title="direction [deg]", loc="outside right upper")
    return save_titled(figure, f"{name}: restoring force and tension over the offset", path)
