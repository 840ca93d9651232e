"""Picture of the mussels of a scene by month and depth."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np

from dropper_jax.base.markdown import first_names
from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.plots import figures, style, tension_colours
from dropper_jax.study.curves import grouped, save_titled, series


@style.plot_style()
def draw_mussels(name: str, rows: Sequence[Table], path: str | Path) -> Path:
    """Layer and wet weight over depth, a curve for each month, a column for each rope.

    Dashes: below the last depth of the table values are constant.

    Args:
        rows: of `modelling.growth.season_table`, in which all ropes have the same months.
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
