"""The current from above, with the wakes of lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.modelling.wakes import SceneWakes
from dropper_jax.plots import figures, style
from dropper_jax.plots.style import DARK


@style.plot_style()
def flow_map(name: str, found: SceneWakes, path: str | Path) -> Path:
    """Current [m/s] at the mean height of the lines, along and across it, with the lines' links [m]."""
    wakes = found.wakes
    e = wakes.elements
    height = np.average(e.z, weights=e.drag_coefficient * e.area + 1e-12)
    size = max(np.ptp(e.x), np.ptp(e.y), 10.0)
    x = np.linspace(e.x.min() - 0.1 * size, e.x.max() + 0.8 * size, 90)
    y = np.linspace(e.y.min() - 0.25 * size, e.y.max() + 0.25 * size, 160)
    speed = wakes.velocity(x, y, height)
    figure = figures.new_figure(9.0, 5.6)
    axes = figure.subplots()
    shown = axes.pcolormesh(x, y, speed.T, cmap="viridis", vmin=0.0, vmax=wakes.speed, shading="gouraud")
    axes.plot(e.x, e.y, ".", color="white", ms=2.5, mec=DARK, mew=0.3, label="links")
    axes.set(xlabel="along the current [m]", ylabel="across it [m]", aspect="equal")
    axes.grid(False)
    figure.colorbar(shown, ax=axes, label=f"current at z = {height:.1f} m [m/s]", shrink=0.8)
    figures.title(figure, f"{name}: {wakes.speed:.2f} m/s towards {np.degrees(found.direction):.0f} degrees from x")
    return figures.save(figure, path)
