"""Pictures of a sweep: each stored quantity over one varied input, or over two as a map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from dropper_jax.base.errors import SceneError
from dropper_jax.plots import figures, style, tension_colours
from fitting.sweep.plan import QUANTITIES
from fitting.sweep.run import open_sweep
from fitting.sweep.trace_pictures import short_path

if TYPE_CHECKING:
    import xarray


@style.plot_style()
def draw_sweep(path: str | Path, folder: str | Path) -> list[Path]:
    """A picture `QUANTITY.png` for each quantity of a sweep with one value per case.

    One input gives a line, two give a map; with more inputs, the mean over all but the first two. Of values per link
    the maximum.

    Raises:
        SceneError: the sweep stored no quantity with one value per case.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    with open_sweep(path) as found:
        names = [name for name in QUANTITIES if name in found]
        names += [name for name in map(str, found.data_vars) if "." in name]
        for name in names:
            files.append(figures.save(_draw_quantity(found[name]), folder / f"{name}.png"))
    if not files:
        raise SceneError(f"{path}: contains no quantity to draw. Use a sweep of {', '.join(QUANTITIES)}")
    return files


def _draw_quantity(values: xarray.DataArray) -> Figure:
    """A quantity over its first input, or its first two as a map; of values per link the maximum."""
    label = f"{values.attrs['long_name']} [{values.attrs['units']}]"
    if "link" in values.dims:
        values = values.max("link")
    averaged = values.dims[2:]
    mean = values.mean(averaged) if averaged else values
    figure = figures.new_figure(7.0, 4.4)
    axes = figure.subplots()
    axes.set_xlabel(short_path(mean.dims[0]))
    if mean.ndim == 1:
        axes.plot(mean[mean.dims[0]], mean, "o-", color=style.FIRST, ms=3.5)
        axes.set_ylabel(label)
    else:
        x, y = (np.asarray(mean[name]) for name in mean.dims)
        mesh = axes.pcolormesh(x, y, np.asarray(mean).T, cmap=tension_colours.tension_map(), shading="nearest")
        figure.colorbar(mesh, ax=axes, label=label)
        axes.set_ylabel(short_path(mean.dims[1]))
        axes.grid(False)
    if averaged:
        axes.set_title(f"mean over {', '.join(map(short_path, averaged))}", loc="left")
    return figure
