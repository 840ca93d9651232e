"""Map of the current behind the lines, from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.plots import style
from dropper_jax.run.wakes import SceneWakes

#: Number of points along and across the current.
ALONG, ACROSS = 90, 160


@style.plot_style()
def flow_map(name: str, found: SceneWakes, path: str | Path) -> Path:
    """Current [m/s] at the mean height of the lines, along and across it, with the lines' links [m]."""
    wakes, e = found.wakes, found.wakes.elements
    weight = e.drag * e.area + 1e-12
    height = float(np.sum(weight * e.z) / np.sum(weight))
    size = max(float(np.ptp(e.x)), float(np.ptp(e.y)), 10.0)
    x = np.linspace(e.x.min() - 0.1 * size, e.x.max() + 0.8 * size, ALONG)
    y = np.linspace(e.y.min() - 0.25 * size, e.y.max() + 0.25 * size, ACROSS)
    speed = wakes.velocity(x, y, height)
    figure = style.new_figure(9.0, 5.6)
    axes = figure.subplots()
    shown = axes.pcolormesh(x, y, speed.T, cmap="viridis", vmin=0.0, vmax=wakes.speed, shading="gouraud")
    axes.plot(e.x, e.y, ".", color="white", ms=2.5, mec=style.DARK, mew=0.3, label="links")
    axes.set(xlabel="along the current [m]", ylabel="across it [m]", aspect="equal")
    axes.grid(False)
    figure.colorbar(shown, ax=axes, label=f"current at z = {height:.1f} m [m/s]", shrink=0.8)
    text = f"{name}: {wakes.speed:.2f} m/s towards {np.degrees(found.direction):.0f} degrees from x"
    figure.suptitle(text, fontsize=12, fontweight="bold", x=0.01, ha="left")
    return style.save(figure, path)
