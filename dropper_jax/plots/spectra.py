"""Amplitude spectra: of the links of one line, and of the tensions and motions of a system."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator

from dropper_jax.analysis import spectrum
from dropper_jax.base.records import names_of
from dropper_jax.plots import figures, panels, style, view
from dropper_jax.plots.motion import motion_panels
from dropper_jax.plots.movement import ANGLE_ROUNDING, directions
from dropper_jax.plots.run import Run
from dropper_jax.plots.style import CYCLE, FAINT
from dropper_jax.plots.tension import ends_panel, scale_tensions
from dropper_jax.plots.time_panels import Curve, Panel, draw_panel, legend, line_style


@style.with_style
def amplitude_spectrum(run: Run, path: str | Path) -> Path:
    """Amplitude spectrum of each link's motion (Hann window), one panel per link that moves (at most twelve).

    They are evenly spaced in one line; of several lines they are those that move most.
    In a plane the spectrum is that of the polar angle [rad]. In space it is that of the x and y components of the unit
    link vector [-], since the angles of a conical motion are constant or grow without limit.
    Of a system it is that of tensions [N or kN] and of motions [m] under the surface, as in their histories.
    """
    if run.scene.single_line is None:
        return _system_spectra(run, path)
    # height of the axis of a spectrum [decades]
    decades = 4
    if view.planar(run.positions):
        series = {"polar angle": run.polar}
        what = "amplitude spectrum of the link angles"
        unit = "rad"
    else:
        unit_vectors = directions(run)
        series = {"x component": unit_vectors[..., 0], "y component": unit_vectors[..., 1]}
        what = "amplitude spectrum of the link directions"
        unit = "-"
    spectra = [(name, *uniform_spectrum(run.t, values)) for name, values in series.items()]
    frequency = spectra[0][1]
    amplitudes = np.array([amplitude for _, _, amplitude in spectra])
    top = max(amplitudes.max(), ANGLE_ROUNDING)
    floor = top * 10.0**-decades
    last = _last_frequency(frequency, amplitudes)

    def draw(axes: Axes, link: int) -> None:
        curves = [Curve(name, frequency, amplitude[:, link]) for name, _, amplitude in spectra]
        for index, (colour, curve) in enumerate(zip(CYCLE, curves, strict=False)):
            values = np.maximum(curve.values, 0.1 * floor)
            axes.plot(frequency, values, label=curve.name, color=colour, lw=1.2, ls=line_style(curves, index))
        if frequency[-1] == 0.0:
            axes.text(0.5, 0.5, "too few samples", transform=axes.transAxes, ha="center", color=FAINT)
        axes.set_yscale("log")
        axes.set_ylim(floor, 2 * top)
        axes.yaxis.set_major_locator(LogLocator(numticks=decades + 2))
        axes.yaxis.minorticks_off()
        axes.set_xlim(0, last)

    labels = ("frequency [Hz]", f"amplitude [{unit}]")
    return panels.grid(run, path, what, draw, labels, share=True)


def _system_spectra(run: Run, path: str | Path) -> Path:
    """Spectra of the tensions at the ends of lines, of the motion and of the surface, a panel each; in waves also the
    vertical motion over the surface."""
    spectra = list(map(_spectra, (ends_panel(run, scale_tensions(run)), *motion_panels(run))))
    shown = [*spectra, *_heave_ratio(spectra)]
    figure = figures.new_figure(8.5, 1.2 + 1.75 * len(shown))
    all_axes = figures.panels(figure, len(shown), sharex=True)
    for axes, panel in zip(all_axes, shown, strict=True):
        draw_panel(axes, panel)
        axes.set_ylabel(panel.label)
        axes.set_title(panel.title, loc="left", fontsize=9)
        if any(names_of(panel.curves)):
            legend(axes)
    firsts = [panel.curves[0] for panel in spectra]
    last = np.median([_last_frequency(curve.t, curve.values[None, :, None]) for curve in firsts])
    all_axes[-1].set(xlabel="frequency [Hz]", xlim=(0.0, last))
    figure.align_ylabels()
    return figures.finish(figure, run, "amplitude spectra", path)


def _spectra(panel: Panel) -> Panel:
    """A panel against time as one against frequency [Hz]."""
    curves = [Curve(c.name, *uniform_spectrum(c.t, c.values), colour=c.colour) for c in panel.curves]
    return Panel(panel.label.replace(" from its start", ""), curves, panel.title)


def _heave_ratio(spectra: list[Panel]) -> list[Panel]:
    """Amplitude of the vertical motion over that of the surface where the waves are; empty without waves.

    Powers are averaged over nine frequencies first: the ratio of single ones scatters in irregular waves.
    """
    by_label = {panel.label: panel.curves for panel in spectra}
    band = np.full(9, 1 / 9)
    heaves = by_label.get("z [m]")
    if heaves is None or "surface [m]" not in by_label or len(heaves[0].values) < 2 * len(band):
        return []
    surface = by_label["surface [m]"][0].values
    waves = surface >= 0.1 * surface.max()
    curves = []
    for curve in heaves:
        heave, wave = (np.convolve(values**2, band, "same")[waves] for values in (curve.values, surface))
        curves.append(Curve(curve.name, curve.t[waves], np.sqrt(heave / wave), colour=curve.colour))
    return [Panel("ratio [m/m]", curves, "vertical motion over surface elevation, at the frequencies of the waves")]


def uniform_spectrum(t: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (m,) [Hz] and amplitudes (m,) or (m, n) without a shorter last step of the run; zero for fewer than
    four samples."""
    count = len(t)
    if count > 2 and abs((t[-1] - t[-2]) - (t[1] - t[0])) >= spectrum.STEP_TOLERANCE * (t[1] - t[0]):
        count -= 1
    if count < 4:
        return np.zeros(2), np.zeros((2, *values.shape[1:]))
    return spectrum.amplitude_spectrum(t[:count], values[:count])


#: The frequency axis shows this fraction of the power.
SHOWN_POWER = 0.999


def _last_frequency(frequency: np.ndarray, amplitudes: np.ndarray) -> float:
    """End of the frequency axis [Hz]: slightly above the band with nearly all the power of every link."""
    if frequency[-1] == 0:
        return 1.0
    power = np.cumsum((amplitudes**2).sum(axis=(0, 2)))
    if power[-1] == 0:
        return frequency[-1]
    band = frequency[np.searchsorted(power, SHOWN_POWER * power[-1])]
    return min(frequency[-1], 2 * band + 2 * frequency[1])
