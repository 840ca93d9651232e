"""Picture of the cost of each effect of a scene."""

from __future__ import annotations

from pathlib import Path

from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.plots import figures, style
from dropper_jax.study.curves import save_titled


@style.plot_style()
def draw_costs(report: Table, path: str | Path) -> Path:
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
