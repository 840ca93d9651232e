"""Response of a link to the water: elevation, spectra of its angles and their phase space."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.plots import figures, marks, scales, style
from dropper_jax.plots.movement import ANGLE_ROUNDING, swing
from dropper_jax.plots.run import Run, elevations, sea_of
from dropper_jax.plots.spectra import uniform_spectrum
from dropper_jax.plots.style import CYCLE
from dropper_jax.plots.surroundings import SURFACE


@style.with_style
def response(run: Run, path: str | Path) -> Path:
    """Elevation; angles of a link: spectra and phase space, as thesis figures 8.32 to 8.34.

    It is the tenth link, as in the thesis; of several lines, or if it does not move, the link that rotates most.
    """
    sea_of(run)
    index = _response_link(run)
    eta = elevations(run.scene, np.zeros((1, 3)), run.t)[:, 0]
    turning = []
    for name, angles, rates, colour in zip(("polar", "azimuth"), run.angles, run.angle_rates(), CYCLE, strict=False):
        turning.append((name, angles[:, index], rates[:, index], colour))
    turning = [row for row in turning if np.ptp(row[1]) > ANGLE_ROUNDING] or turning[:1]
    figure = figures.new_figure(9.5, 7.6)
    grid = figure.add_gridspec(3, len(turning), height_ratios=(1.0, 1.3, 1.6))
    top = figure.add_subplot(grid[0, :])
    top.plot(run.t, eta, color=SURFACE)
    top.set_ylabel("elevation [m]")
    scales.time_axis(top, run.t)
    spectra = figure.add_subplot(grid[1, :])
    for column, (name, angle, rate, colour) in enumerate(turning):
        frequency, size = uniform_spectrum(run.t, angle)
        spectra.plot(frequency[1:], size[1:], color=colour, label=name)
        if frequency[-1] > 0.0:  # a run of a few samples has no spectrum
            spectra.set_xscale("log")
        space = figure.add_subplot(grid[2, column])
        space.plot(angle, rate, color=colour, lw=0.7, marker=marks.marker(run.t))
        space.set(xlabel=f"{name} angle [rad]", ylabel="rate [rad/s]")
    spectra.set(xlabel="frequency [Hz]", ylabel="amplitude [rad]")
    spectra.legend()
    return figures.finish(figure, run, f"response of {run.labels[index]}", path)


def _response_link(run: Run) -> int:
    """The link whose response is drawn."""
    swings = swing(run)
    tenth = min(10, run.tension.shape[1]) - 1
    if len(run.written_lines) == 1 and swings[tenth] > ANGLE_ROUNDING:
        return tenth
    return int(np.argmax(swings))
