"""Pictures of the studies and of a scene near equilibrium, in the style of `dropper_jax.plots`."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np

from dropper_jax import plots
from dropper_jax.base.markdown import first_names
from dropper_jax.base.read import Table
from dropper_jax.base.records import column, rows_where
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.plots import figures, style, tension_colours, view
from dropper_jax.run.samples import Samples
from dropper_jax.scene import line_slices
from dropper_jax.statics import Equilibrium
from dropper_jax.statics.modes import Modes
from dropper_jax.study.curves import grouped, marks, save_titled, series


def pose(scene: Scene, found: Equilibrium, path: str | Path) -> Path:
    """The equilibrium, with links coloured by tension [N]."""
    once = np.zeros(1)
    solution = Samples(
        scene=scene,
        settings={"integrator": "static pose", "dt": 0.0},
        status=found.status,
        t=once,
        positions=found.positions[None],
        velocities=np.zeros((1, *np.shape(found.positions))),
        tension=found.tension[None],
        t_tension=once,
        kinetic=once,
        potential=once,
        work=np.zeros((1, 0)),
        work_names=(),
        step_status=once,
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
    rest = found.positions
    size = view.size(rest)
    low = np.ptp(rest[:, 2]) < LOW_AND_LONG * max(np.ptp(rest[:, 0]), np.ptp(rest[:, 1]))
    columns = 1 if low else min(count, 3)
    rows = -(-count // columns)
    figure_size = (3.6 * columns + 0.6, 2.9 * rows + 0.8)
    if low:
        figure_size = (8.0, 1.5 * rows + 0.8)
    figure = figures.new_figure(*figure_size)
    for i, axes in enumerate(figures.panels(figure, count, columns)):
        shape = np.asarray(modes.shape[i])
        shape = shape * SHAPE_SIZE * size / max(np.abs(shape).max(), np.finfo(float).tiny)
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
def responses(name: str, rows: Sequence[Table], path: str | Path) -> Path:
    """Amplitude, mean and phase of the first link over the waves' period, and its amplitude in waves 10 % higher."""
    figure = figures.new_figure(7.5, 6.2)
    panels = figure.subplots(3, 1, sharex=True)
    period = series(rows, "period_s")
    amplitude = series(rows, "amplitude_rad")
    curves = {"amplitude": amplitude, "mean": series(rows, "mean_rad"), "phase": np.unwrap(series(rows, "phase_rad"))}
    for axes, (label, values) in zip(panels, curves.items(), strict=True):
        axes.plot(period, values, label="as in the scene", **marks(0))
        axes.set_ylabel(f"{label} [rad]")
    if all(row.get("amplitude_10_percent_more") is not None for row in rows):
        higher = amplitude * (1.0 + series(rows, "amplitude_10_percent_more"))
        panels[0].plot(period, higher, label="waves 10 % higher", **marks(1))
        figures.legend_above(panels[0], 2, borderaxespad=0.2)
    panels[-1].set_xlabel("period of the waves [s]")
    figure.align_ylabels()
    return save_titled(figure, f"{name}: angle of the first link in regular waves", path)


@style.plot_style()
def mussels(name: str, rows: Sequence[Table], path: str | Path) -> Path:
    """Layer and wet weight over depth, a curve for each month, a column for each rope.

    Dashes: below the last depth of the table values are constant.
    """
    ropes = grouped(rows, lambda row: tuple(row["lines"]))
    figure = figures.new_figure(max(3.6 * len(ropes), 5.0) + 0.8, 6.4)
    grid = figure.subplots(2, len(ropes), sharey=True, squeeze=False)
    below = 0.2 * np.max(series(rows, "depth_m")) or 1.0
    for (layer, weight), (lines, own) in zip(grid.T, ropes.items(), strict=True):
        months = grouped(own, itemgetter("month"))
        for i, (month, shown) in enumerate(months.items()):
            depth = column(shown, "depth_m")
            colour = tension_colours.tension_map()(0.9 * i / max(len(months) - 1, 1))
            for axes, key, size in ((layer, "thickness_m", 1e3), (weight, "wet_weight_n_per_m", 1.0)):
                values = size * series(shown, key)
                axes.plot(values, depth, "o-", color=colour, ms=3.5, label=f"month {month:g}")
                axes.plot(values[[-1, -1]], [depth[-1], depth[-1] + below], color=colour, ls="--")
        layer.set_title(first_names(lines, 1), loc="left", fontsize=9)
        for axes, label in ((layer, "layer [mm]"), (weight, "wet weight [N/m]")):
            axes.axvline(0.0, color=style.FAINT, lw=0.7)
            axes.set_xlabel(label)
    grid[0, 0].invert_yaxis()
    for axes in grid[:, 0]:
        axes.set_ylabel("depth [m]")
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside right upper")
    return save_titled(figure, f"{name}: mussels by depth and month", path)


@style.plot_style()
def tide(name: str, rows: Sequence[Table], path: str | Path) -> Path:
    """Current, level, excursion and force on the fixed points through a cycle."""
    figure = figures.new_figure(7.5, 6.2)
    water, moved, tension = figure.subplots(3, 1, sharex=True)
    hours = series(rows, "t_s") / 3600.0
    water.plot(hours, series(rows, "speed_m_per_s"), label="current [m/s]", **marks(0))
    water.plot(hours, series(rows, "level_m"), label="level [m]", **marks(1))
    moved.plot(hours, series(rows, "displacement_m"), **marks(0))
    moved.set_ylabel("moved [m]")
    loads = column(rows, "held_load_n")
    for i, point in enumerate(loads[0]):
        tension.plot(hours, np.linalg.norm([load[point] for load in loads], axis=1) / 1e3, label=point, **marks(i))
    tension.set(xlabel="time [h]", ylabel="force [kN]")
    for axes in (water, tension):
        figures.legend_above(axes, 4, fontsize=8, borderaxespad=0.2)
    figure.align_ylabels()
    return save_titled(figure, f"{name}: through the tide", path)


@style.plot_style()
def costs(report: Table, path: str | Path) -> Path:
    """Microseconds, operations and bytes per step of the scene without each of its effects, one bar each."""
    rows = report["rows"]
    figure = figures.new_figure(11.0, 1.6 + 0.42 * len(rows))
    names = column(rows, "name")
    colours = [style.FIRST, *[style.FAINT] * len(rows)][: len(rows)]  # the whole scene comes first
    parts = (("us_per_step", "microseconds per step"), ("flops", "operations per step"), ("bytes", "bytes per step"))
    for axes, (key, label) in zip(figure.subplots(1, 3, sharey=True), parts, strict=True):
        values = [row[key] or 0.0 for row in rows]
        axes.bar_label(axes.barh(names, values, color=colours), [f"{v:.4g}" for v in values], fontsize=8, padding=2)
        axes.set_xlim(0, 1.25 * max([*values, 1e-9]))
        axes.set_xlabel(label)
        if key == "us_per_step":
            axes.invert_yaxis()
        axes.grid(axis="y", visible=False)
    return save_titled(
        figure, f"{report['scene']}: what each effect costs ({report['integrator']}, {report['solver']})", path
    )


@style.plot_style()
def offsets(name: str, rows: Sequence[Table], path: str | Path) -> Path:
    """Restoring force and maximum tension over the offset, a curve for each direction."""
    figure = figures.new_figure(9.5, 4.4)
    restoring, tension = figure.subplots(1, 2, sharex=True)
    for i, (direction, own) in enumerate(grouped(rows, itemgetter("direction_deg")).items()):
        shown = rows_where(own, "status", "ok")
        for axes, key in ((restoring, "restoring_n"), (tension, "max_tension_n")):
            axes.plot(series(shown, "distance_m"), series(shown, key) / 1e3, label=f"{direction:g}", **marks(i))
    restoring.set(xlabel="offset [m]", ylabel="restoring force [kN]")
    tension.set(xlabel="offset [m]", ylabel="maximum tension [kN]")
    figure.legend(*restoring.get_legend_handles_labels(), title="direction [deg]", loc="outside right upper")
    return save_titled(figure, f"{name}: restoring force and tension over the offset", path)
