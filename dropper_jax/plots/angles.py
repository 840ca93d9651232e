"""Angles of the links: against time, and against their rates."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from dropper_jax.plots import panels, scales, style, view
from dropper_jax.plots.run import Run
from dropper_jax.plots.style import DARK, FIRST, SECOND


@style.with_style
def angle_traces(run: Run, path: str | Path) -> Path:
    """Polar angle [rad] of every link against time, positive below the horizontal; in space also the azimuth."""
    polar, azimuth = run.angles
    columns = [("polar angle [rad]", polar)]
    if not view.planar(run.positions):
        columns.append(("azimuth [rad]", azimuth))
    return panels.traces(run, path, "link angles", columns)


@style.with_style
def phase_space(run: Run, path: str | Path) -> Path:
    """Polar angle [rad] against its rate [rad/s], one panel per link that moves (at most twelve).

    They are evenly spaced in one line; of several lines they are those that move most.
    """
    angles = run.polar
    rates, _ = run.angle_rates()
    # A long chaotic curve would fill the panel: draw it thinner.
    width = 0.4 if len(angles) > 4000 else 0.9

    def draw(axes: Axes, link: int) -> None:
        angle = angles[:, link]
        rate = rates[:, link]
        axes.plot(angle, rate, color=FIRST, lw=width, alpha=0.8)
        axes.plot(angle[0], rate[0], "o", ms=5, mfc="white", mec=DARK, label="start")
        axes.plot(angle[-1], rate[-1], "o", ms=5, color=SECOND, label="end")
        scales.widen(angle, axes.set_xlim)
        scales.widen(rate, axes.set_ylim)
        axes.xaxis.set_major_locator(MaxNLocator(3))  # labels of more digits would touch

    labels = ("polar angle [rad]", "rate [rad/s]")
    return panels.grid(run, path, "phase space of the links", draw, labels, share=False)
