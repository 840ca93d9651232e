"""Pictures of accuracy: error against time and step, convergence of each scheme, numerical damping."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from dropper_jax.base.read import Table
from dropper_jax.plots import style
from dropper_jax.study.pictures import marks, save_titled


@style.plot_style()
def work_precision(report: Table, path: str | Path) -> Path:
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
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
    return save_titled(
        figure, f"{report['scene']}: accuracy against time, first {report['reference']['horizon_s']:.3g} s", path
    )


def _series(axes: Axes, rows: list[Table], x: str, y: str, label: str, index: int) -> None:
    rows = sorted((r for r in rows if (r[y] or 0) > 0), key=lambda r: r["dt"])
    if rows:
        axes.plot([r[x] for r in rows], [r[y] for r in rows], label=label, lw=1.0, **marks(index))


def _slopes(axes: Axes, rows: list[Table]) -> None:
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
def convergence(report: Table, path: str | Path) -> Path:
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
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=7, fontsize=8)
    return save_titled(figure, f"{report['scene']}: each step against its half", path)


def _links(axes: Axes, scheme: Table, kind: str, numbers: Sequence[int]) -> None:
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
def damping(report: Table, path: str | Path) -> Path:
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


def _damping_series(axes: Axes, rows: list[Table], label: str, index: int, count: int) -> None:
    good = [r for r in rows if r["status"] == "ok"]
    bad = [r for r in rows if r["status"] != "ok"]
    look = marks(index)
    axes.plot([r["dt"] for r in good], [r["equivalent_linear_damping"] for r in good], label=label, lw=1.0, **look)
    height = 0.35 * 1.12 ** (index - count / 2)  # a row of crosses per scheme, so that they do not overlap
    axes.plot([r["dt"] for r in bad], [height] * len(bad), ls="", marker="x", ms=5, color=look["color"])
