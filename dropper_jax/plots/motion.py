"""Angles of the links: against time, against their rates, and their spectra."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator

from dropper_jax.analysis import spectrum
from dropper_jax.plots import moving, panels, style, view
from dropper_jax.plots.motion_histories import motion_panels
from dropper_jax.plots.run import Run
from dropper_jax.plots.series import Curve, Panel, draw_panel, legend
from dropper_jax.plots.tension import ends_panel

#: Height of the axis of a spectrum [decades], and the fraction of the power that its frequency axis shows.
DECADES, SHOWN = 4, 0.999


@style.with_style
def angle_traces(run: Run, path: str | Path) -> Path:
    """Polar angle [rad] of every link against time, positive below the horizontal; in space also the azimuth."""
    t, positions = run.t, run.positions
    polar, azimuth = run.angles()
    columns = [("polar angle [rad]", polar)]
    if not view.planar(positions):
        columns.append(("azimuth [rad]", azimuth))
    return panels.traces(run, path, "link angles", t, columns, moving.ANGLE, centred=True)


@style.with_style
def phase_space(run: Run, path: str | Path) -> Path:
    """Polar angle [rad] against its rate [rad/s], one panel per link that moves (at most twelve).

    They are evenly spaced in one line; of several lines they are those that move most.
    """
    (angle, _), (rate, _) = run.angles(), run.angle_rates()
    long = len(angle) > 4000

    def draw(axes: Axes, link: int) -> None:
        # A long chaotic curve would fill the panel: draw it thinner.
        axes.plot(angle[:, link], rate[:, link], color=style.FIRST, lw=0.4 if long else 0.9, alpha=0.8)
        axes.plot(*(x[0, link] for x in (angle, rate)), "o", ms=5, mfc="white", mec=style.DARK, label="start")
        axes.plot(*(x[-1, link] for x in (angle, rate)), "o", ms=5, color=style.SECOND, label="end")
        style.widen(angle[:, link], axes.set_xlim)
        style.widen(rate[:, link], axes.set_ylim)
        axes.xaxis.set_major_locator(MaxNLocator(5))

    labels = ("polar angle [rad]", "rate [rad/s]")
    return panels.grid(
        run, path, "phase space of the links", moving.chosen_links(run, panels.MOST), draw, labels, False
    )


@style.with_style
def amplitude_spectrum(run: Run, path: str | Path) -> Path:
    """Amplitude spectrum of each link's motion (Hann window), one panel per link that moves (at most twelve).

    They are evenly spaced in one line; of several lines they are those that move most.
    In a plane the spectrum is that of the polar angle [rad]. In space it is that of the x and y components of the unit
    link vector [-], since the angles of a conical motion are constant or grow without limit.
    Of a system it is that of tensions [N or kN] and of motions [m] under the surface, as in their histories.
    """
    if run.scene is not None:
        return _system_spectra(run, path)
    t, positions = run.t, run.positions
    flat = view.planar(positions)
    uniform = _uniform(t)
    series = {"polar angle": run.angles()[0]} if flat else _directions(run)
    if uniform < 2:
        spectra = {name: (np.zeros(1), np.zeros((1, run.tension.shape[1]))) for name in series}
    else:
        spectra = {name: spectrum.amplitude_spectrum(t[:uniform], values[:uniform]) for name, values in series.items()}
    amplitudes = np.array([a for _, a in spectra.values()])
    top = max(amplitudes.max(), moving.ANGLE)
    floor = top * 10.0**-DECADES
    last = _last_frequency(next(iter(spectra.values()))[0], amplitudes)

    def draw(axes: Axes, link: int) -> None:
        for colour, (name, (frequency, amplitude)) in zip(style.CYCLE, spectra.items(), strict=False):
            axes.plot(frequency, np.maximum(amplitude[:, link], 0.1 * floor), color=colour, lw=0.8, label=name)
        if uniform < 4:
            axes.text(0.5, 0.5, "too few samples", transform=axes.transAxes, ha="center", color=style.FAINT)
        axes.set_yscale("log")
        axes.set_ylim(floor, 2 * top)
        axes.yaxis.set_major_locator(LogLocator(numticks=DECADES + 2))
        axes.yaxis.minorticks_off()
        axes.set_xlim(0, last)

    labels = ("frequency [Hz]", "amplitude [rad]" if flat else "amplitude [-]")
    what = "amplitude spectrum of the link angles" if flat else "amplitude spectrum of the link directions"
    return panels.grid(run, path, what, moving.chosen_links(run, panels.MOST), draw, labels, share=True)


def _system_spectra(run: Run, path: str | Path) -> Path:
    """Spectra of the tensions at the ends of lines, of the motion and of the surface, a panel each."""
    shown = [_spectra(panel) for panel in (ends_panel(run), *motion_panels(run))]
    figure = style.new_figure(8.5, 1.2 + 1.75 * len(shown))
    all_axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(all_axes, shown, strict=True):
        draw_panel(axes, panel, run)
        axes.set_ylabel(panel.label)
        axes.set_title(panel.title, loc="left", fontsize=9)
        if any(curve.name for curve in panel.curves):
            legend(axes)
    firsts = [panel.curves[0] for panel in shown]
    last = np.median([_last_frequency(curve.t, curve.values[None, :, None]) for curve in firsts])
    all_axes[-1].set(xlabel="frequency [Hz]", xlim=(0.0, last))
    figure.align_ylabels()
    style.title(figure, run, "amplitude spectra")
    return style.save(figure, path)


def _spectra(panel: Panel) -> Panel:
    """A panel against time as one against frequency [Hz]; zero for too few samples."""
    curves = []
    for curve in panel.curves:
        count = _uniform(curve.t)
        pair = (np.zeros(2), np.zeros(2))
        if count >= 4:
            pair = spectrum.amplitude_spectrum(curve.t[:count], curve.values[:count])
        curves.append(Curve(curve.name, *pair, colour=curve.colour))
    return Panel(panel.label.replace(" from its start", ""), curves, panel.title)


def _directions(run: Run) -> dict[str, np.ndarray]:
    """x and y components of the unit link vectors, each (k, n)."""
    links = run.positions[:, run.first + 1] - run.positions[:, run.first]
    length = np.linalg.norm(links, axis=-1, keepdims=True)
    unit = links / np.where(length > 0, length, 1.0)
    return {"x component": unit[..., 0], "y component": unit[..., 1]}


def _uniform(t: np.ndarray) -> int:
    """Number of samples to use, without a shorter last step at the end of the run."""
    if len(t) < 3:
        return len(t)
    return len(t) if abs((t[-1] - t[-2]) - (t[1] - t[0])) < 1e-3 * (t[1] - t[0]) else len(t) - 1


def _last_frequency(frequency: np.ndarray, amplitudes: np.ndarray) -> float:
    """End of the frequency axis [Hz]: slightly above the band with nearly all the power of every link."""
    if frequency[-1] == 0:
        return 1.0
    power = np.cumsum((amplitudes**2).sum(axis=(0, 2)))
    if power[-1] == 0:
        return float(frequency[-1])
    return float(min(frequency[-1], 2 * frequency[np.searchsorted(power, SHOWN * power[-1])] + 2 * frequency[1]))
