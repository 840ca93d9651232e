"""Pictures of lines in water: elevation at a point, line and surface, response of a link, tension envelope."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib.style
import numpy as np

from dropper_jax.analysis.angles import link_angles
from dropper_jax.analysis.spectrum import amplitude_spectrum
from dropper_jax.build import build_model
from dropper_jax.plots import style
from dropper_jax.plots.run import Run, readable

WATER, SURFACE = "#DCEBF5", "#56B4E9"
#: Points along the surface of a picture.
POINTS = 240


def _drawn(draw: Callable[..., Path]) -> Callable[..., Path]:
    """Give `draw` the readable run and its sea, in the common style."""

    def wrapper(solution: Any, path: str | Path, **kwargs: Any) -> Path:
        sea = build_model(solution.scene, "float64").sea
        if sea is None:
            raise ValueError(f"solution: scene {solution.scene.name!r} has no [sea]; allowed: a scene with water")
        with matplotlib.style.context(["default", style.RC]):
            return draw(readable(solution), sea, path, **kwargs)

    wrapper.__doc__, wrapper.__name__ = draw.__doc__, draw.__name__
    return wrapper


def _surface(sea: Any, places: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Elevation (q, n) [m] at places (n, 3) and times (q,)."""
    return np.asarray(jax.jit(jax.vmap(sea.elevation, (None, 0)))(jnp.asarray(places), jnp.asarray(times)))


@_drawn
def elevation(run: Run, sea: Any, path: str | Path, place: tuple[float, float] = (0.0, 0.0)) -> Path:
    """Elevation [m] of the surface at a place (x, y) [m] against time."""
    eta = _surface(sea, np.array([[*place, 0.0]]), run.t)[:, 0]
    figure = style.new_figure(8.5, 3.2)
    axes = figure.subplots()
    axes.fill_between(run.t, eta, eta.min() - 0.1 * (np.ptp(eta) or 1.0), color=WATER)
    axes.plot(run.t, eta, color=style.FIRST)
    axes.set_ylabel("elevation [m]")
    style.time_axis(axes, run.t)
    style.title(figure, run, f"surface at x = {place[0]:g} m, y = {place[1]:g} m")
    return style.save(figure, path)


@_drawn
def under_surface(run: Run, sea: Any, path: str | Path, time: float | None = None) -> Path:
    """The line [m] and the surface above it at a time [s] (default: the largest tension), seen from two sides."""
    index = int(np.argmax(np.max(run.tension, axis=1))) if time is None else int(np.argmin(np.abs(run.t - time)))
    nodes = run.positions[index]
    middle, half = nodes.mean(axis=0), 0.75 * max(np.ptp(nodes, axis=0).max(), 1.0)
    figure = style.new_figure(9.5, 5.6)
    for axis, axes in enumerate(figure.subplots(1, 2, sharey=True)):
        along = np.linspace(middle[axis] - half, middle[axis] + half, POINTS)
        places = np.tile(middle, (POINTS, 1))
        places[:, axis] = along
        eta = _surface(sea, places, run.t[index : index + 1])[0]
        low = max(nodes[:, 2].min() - 0.1 * half, -float(sea.depth))
        axes.fill_between(along, eta, low, color=WATER)
        axes.plot(along, eta, color=SURFACE, label="surface")
        axes.axhline(0.0, color=style.FAINT, lw=0.7, ls="--")
        axes.plot(nodes[:, axis], nodes[:, 2], "-o", color=style.DARK, ms=3.5, label="line")
        axes.plot(nodes[[0, -1], axis], nodes[[0, -1], 2], "s", color=style.SECOND, ms=6, label="ends")
        axes.set(xlabel=f"{'xy'[axis]} [m]", xlim=(along[0], along[-1]), ylim=(low, None))
        axes.set_aspect("equal", adjustable="box")
    figure.axes[0].set_ylabel("z [m]")
    figure.axes[0].legend(loc="upper left", bbox_to_anchor=(0.0, 1.12), ncols=3)
    style.title(figure, run, f"under the surface at t = {run.t[index]:.2f} s")
    return style.save(figure, path)


@_drawn
def response(run: Run, sea: Any, path: str | Path, link: int = 10) -> Path:
    """Elevation; angles of a link (counted from 1): spectra and phase space, as thesis figures 8.32 to 8.34."""
    angles = link_angles(run.positions, zero="horizontal")
    index = min(link, run.positions.shape[1] - 1) - 1
    eta = _surface(sea, np.zeros((1, 3)), run.t)[:, 0]
    names = ("polar", "azimuth")
    figure = style.new_figure(9.5, 7.6)
    grid = figure.add_gridspec(3, 2, height_ratios=(1.0, 1.3, 1.6))
    top = figure.add_subplot(grid[0, :])
    top.plot(run.t, eta, color=SURFACE)
    top.set_ylabel("elevation [m]")
    style.time_axis(top, run.t)
    spectra, space = figure.add_subplot(grid[1, :]), [figure.add_subplot(grid[2, i]) for i in range(2)]
    for i, name in enumerate(names):
        value = angles[i][:, index]
        frequency, size = amplitude_spectrum(run.t, value - value.mean())
        spectra.semilogx(frequency[1:], size[1:], color=style.CYCLE[i], label=name)
        space[i].plot(value, np.gradient(value, run.t), color=style.CYCLE[i], lw=0.7)
        space[i].set(xlabel=f"{name} angle [rad]", ylabel="rate [rad/s]")
    spectra.set(xlabel="frequency [Hz]", ylabel="amplitude [rad]")
    spectra.legend()
    style.title(figure, run, f"response of link {index + 1}")
    return style.save(figure, path)


@_drawn
def tension_envelope(run: Run, sea: Any, path: str | Path) -> Path:
    """Least, mean and largest tension [N] of each link along the line."""
    del sea
    link = np.arange(1, run.tension.shape[1] + 1)
    tension = run.tension[1:] if len(run.tension) > 1 else run.tension
    figure = style.new_figure(7.5, 4.2)
    axes = figure.subplots()
    axes.fill_between(link, tension.min(axis=0), tension.max(axis=0), color=WATER, label="least to largest")
    for part, shade in ((5, 0.35), (25, 0.6)):
        low, high = np.percentile(tension, (part, 100 - part), axis=0)
        axes.fill_between(link, low, high, color=SURFACE, alpha=shade, lw=0, label=f"{part} to {100 - part} %")
    axes.plot(link, tension.mean(axis=0), "-o", color=style.DARK, ms=3.5, label="mean")
    axes.axhline(0.0, color=style.ALERT, lw=0.8)
    axes.set(xlabel="link", ylabel="tension [N]", xlim=(0.5, link[-1] + 0.5))
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4)
    style.title(figure, run, "tension envelope")
    return style.save(figure, path)
