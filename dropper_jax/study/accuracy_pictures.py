"""Pictures of accuracy: error against time and step, convergence of each scheme, numerical damping."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from dropper_jax.base.read import Table
from dropper_jax.base.records import rows_where
from dropper_jax.plots import figures, style
from dropper_jax.study.curves import grouped, marks, save_titled, series
from dropper_jax.study.damping import THESIS_DT


@style.plot_style()
def work_precision(report: Table, path: str | Path) -> Path:
    """RMS angle error against wall time and against the step, and energy drift against the step, log-log."""
    figure = figures.new_figure(12.0, 5.4)
    axes = figure.subplots(1, 3)
    rows = rows_where(report["rows"], "status", "ok")
    error = ("rms_angle_error_rad", "RMS angle error [rad]")
    step = ("dt", "step [s]")
    time = ("wall_s_per_simulated_s", "wall time per simulated second [s]")
    plots = ((time, error), (step, error), (step, ("energy_drift_j", "energy drift [J]")))
    for ((x, across), (y, up)), panel in zip(plots, axes, strict=True):
        for i, (label, own) in enumerate(grouped(rows, itemgetter("label")).items()):
            shown = sorted((r for r in own if (r[y] or 0) > 0), key=itemgetter("dt"))
            if shown:
                panel.plot(series(shown, x), series(shown, y), label=label, lw=1.0, **marks(i))
        panel.set(xscale="log", yscale="log", xlabel=across, ylabel=up)
    floor = report["reference"]["error_estimate_rad"]
    for panel in axes[:2]:
        panel.axhline(floor, color=style.FAINT, lw=0.8, ls=":")
        _note(panel, "error of the reference", (0.02, floor), (0, 2), ("axes fraction", "data"))
    _slopes(axes[1], rows)
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
    return save_titled(
        figure, f"{report['scene']}: accuracy against time, first {report['reference']['horizon_s']:.3g} s", path
    )


def _note(
    axes: Axes, text: str, at: tuple[float, float], moved: tuple[float, float], of: Any = "data", **options: Any
) -> None:
    """A small text next to a position, in the coordinates `of`."""
    options.setdefault("fontsize", 7)
    axes.annotate(text, at, moved, of, "offset points", **options)


def _slopes(axes: Axes, rows: list[Table]) -> None:
    """Lines of order 1, 2 and 4 to compare with."""
    dts = np.array(sorted(set(series(rows, "dt"))))
    if len(dts) < 2:
        return
    for order, top in ((1, 0.5), (2, 2.0), (4, 0.3)):
        line = top * (dts / dts[-1]) ** order
        axes.plot(dts, line, color=style.FAINT, lw=0.8, zorder=0)
        _note(axes, f"order {order}", (dts[0], line[0]), (3, -8), color=style.FAINT)


@style.plot_style()
def convergence(report: Table, path: str | Path) -> Path:
    """RMS difference of each link's angles between a step and its half (thesis Fig. 5.4, C.1, C.2)."""
    found = report["convergence"]
    kinds = ["polar"]
    if any(scheme["azimuth"] is not None for scheme in found):
        kinds.append("azimuth")
    figure = figures.new_figure(4.2 * len(found) + 0.6, 3.4 * len(kinds) + 0.9)
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
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=7, fontsize=8)
    return save_titled(figure, f"{report['scene']}: each step against its half", path)


def _links(axes: Axes, scheme: Table, kind: str, numbers: Sequence[int]) -> None:
    """Differences of an angle over the step, a curve for each link; failed steps are marked."""
    values = scheme[kind]
    axes.set_title(scheme["label"], loc="left")
    axes.set(xscale="log", yscale="log")
    if values is None:
        return
    values = np.asarray(values)
    for i, number in enumerate(numbers or range(1, 1 + values.shape[1])):
        axes.plot(scheme["dts"], values[:, i], label=f"link {number}", lw=1.0, **marks(i))
    for dt, status in zip(scheme["dts"], scheme["status"], strict=True):
        if status != "ok":
            axes.axvline(dt, color=style.ALERT, lw=0.8, ls=":")
            _note(axes, status, (dt, 0.02), (2, 0), ("data", "axes fraction"), rotation=90, color=style.ALERT)


@style.plot_style()
def damping(report: Table, path: str | Path) -> Path:
    """Equivalent linear damping of each scheme against the step, with what the thesis fitted; failures at the top."""
    found = report["numerical_damping"]
    figure = figures.new_figure(8.0, 5.2)
    axes = figure.subplots()
    schemes = grouped(found["rows"], itemgetter("label"))
    for i, (label, rows) in enumerate(schemes.items()):
        good = rows_where(rows, "status", "ok")
        bad = series([r for r in rows if r["status"] != "ok"], "dt")
        look = marks(i)
        axes.plot(series(good, "dt"), series(good, "equivalent_linear_damping"), label=label, lw=1.0, **look)
        height = 0.35 * 1.12 ** (i - len(schemes) / 2)  # a row of crosses per scheme, so that they do not overlap
        axes.plot(bad, np.full_like(bad, height), ls="", marker="x", ms=5, color=look["color"])
    axes.axhline(found["thesis_b_l"], color=style.DARK, lw=0.9, ls=":")
    axes.axvline(THESIS_DT, color=style.DARK, lw=0.9, ls=":")
    _note(axes, "b_l the thesis fitted, at its step", (THESIS_DT, found["thesis_b_l"]), (3, 3), fontsize=8)
    axes.set(xscale="log", xlabel="step [s]", ylabel="equivalent linear damping [kg/s]")
    axes.set_yscale("symlog", linthresh=1e-6)
    axes.set_ylim(-1e-2, 1.0)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    return save_titled(figure, f"{found['scene']}: numerical damping (below 0: gains; crosses: fails)", path)
