"""Motion over time: angles of the links, their rates and spectra; buoys, bodies, free points or nodes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator

from dropper_jax.analysis import spectrum
from dropper_jax.plots import panels, style, system, view
from dropper_jax.plots.panels import DASHES, Curve, Panel, draw_panel, hides, history, legend
from dropper_jax.plots.run import ANGLE, TRAVEL, Run, chosen_links, directions, elevations, travel
from dropper_jax.plots.tension import ends_panel


@style.with_style
def motion_history(run: Run, path: str | Path) -> Path:
    """x, y and z [m] of buoys, else of free points or nodes, against time, and the surface over the first of them.

    Of several, those with the largest motion, each from its initial position. Directions without motion are left out. A
    long record is drawn as its envelope, with a zoom.
    """
    names = list(tracked_nodes(run))
    return history(run, path, f"motion of {names[0]}" if len(names) == 1 else "motion", motion_panels(run))


def motion_panels(run: Run) -> list[Panel]:
    """The directions that move, and the surface."""
    paths = {name: run.positions[:, node] for name, node in tracked_nodes(run).items()}
    alone = len(paths) == 1
    least = TRAVEL * max(view.size(run.positions[:1]), 1e-300)
    panels = []
    for axis, letter in enumerate("xyz"):
        curves = []
        for name, path in paths.items():
            curves.append(Curve("" if alone else name, run.t, path[:, axis] - (0.0 if alone else path[0, axis])))
        if any(np.ptp(curve.values) > least for curve in curves):
            panels.append(Panel(f"{letter} [m]" if alone else f"{letter} from its start [m]", curves))
    if not panels:  # without motion the picture shows the position
        panels = [Panel("z [m]", [Curve(name, run.t, path[:, 2]) for name, path in paths.items()], "nothing moves")]
    return [*panels, *_surface(run, next(iter(paths.values())), next(iter(paths)))]


def tracked_nodes(run: Run) -> dict[str, int]:
    """Nodes to draw, by name: the buoys with the largest motion, else free points; of a single line its end and the
    node that moves most."""
    way = travel(run)
    lively = int(np.argmax(way))
    nodes = {name: node for name, node in run.point_names.items() if node in run.joints}
    buoys = {buoy.node for buoy in run.buoys}
    wanted = {name: node for name, node in nodes.items() if node in buoys} or nodes
    if not wanted or (len(run.lines) == 1 and lively not in wanted.values()):
        wanted[f"node {lively}"] = lively
    # maximum number of points in one picture
    names = sorted(wanted, key=lambda name: -way[wanted[name]])[:4]
    return {name: wanted[name] for name in names}


def _surface(run: Run, path: np.ndarray, name: str) -> list[Panel]:
    """Elevation [m] over the mean position of a path (k, 3); empty without waves."""
    position = path.mean(axis=0)
    title = f"surface elevation above the mean position of {name}"
    if run.scene.sea is None:
        eta = np.zeros(1)
    else:
        eta = elevations(run.scene, position[None], run.t)[:, 0]
    panel = Panel("surface [m]", [Curve("", run.t, eta, colour=system.SURFACE)], title, zero=True)
    if np.ptp(eta) > 0:
        return [panel]
    return []


@style.with_style
def angle_traces(run: Run, path: str | Path) -> Path:
    """Polar angle [rad] of every link against time, positive below the horizontal; in space also the azimuth."""
    t = run.t
    positions = run.positions
    polar, azimuth = run.angles
    columns = [("polar angle [rad]", polar)]
    if not view.planar(positions):
        columns.append(("azimuth [rad]", azimuth))
    return panels.traces(run, path, "link angles", t, columns, ANGLE, centred=True)


@style.with_style
def phase_space(run: Run, path: str | Path) -> Path:
    """Polar angle [rad] against its rate [rad/s], one panel per link that moves (at most twelve).

    They are evenly spaced in one line; of several lines they are those that move most.
    """
    angle = run.polar
    rate, _ = run.angle_rates()
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
    return panels.grid(run, path, "phase space of the links", chosen_links(run, panels.MOST), draw, labels, False)


@style.with_style
def amplitude_spectrum(run: Run, path: str | Path) -> Path:
    """Amplitude spectrum of each link's motion (Hann window), one panel per link that moves (at most twelve).

    They are evenly spaced in one line; of several lines they are those that move most.
    In a plane the spectrum is that of the polar angle [rad]. In space it is that of the x and y components of the unit
    link vector [-], since the angles of a conical motion are constant or grow without limit.
    Of a system it is that of tensions [N or kN] and of motions [m] under the surface, as in their histories.
    """
    # height of the axis of a spectrum [decades]
    decades = 4
    if run.scene.branched:
        return _system_spectra(run, path)
    t = run.t
    positions = run.positions
    flat = view.planar(positions)
    uniform = _uniform(t)
    unit = directions(run)
    if flat:
        series = {"polar angle": run.polar}
    else:
        series = {f"{x} component": unit[..., i] for i, x in enumerate("xy")}
    if uniform < 2:
        spectra = {name: (np.zeros(1), np.zeros((1, run.tension.shape[1]))) for name in series}
    else:
        spectra = {name: spectrum.amplitude_spectrum(t[:uniform], values[:uniform]) for name, values in series.items()}
    amplitudes = np.array([a for _, a in spectra.values()])
    top = max(amplitudes.max(), ANGLE)
    floor = top * 10.0**-decades
    last = _last_frequency(next(iter(spectra.values()))[0], amplitudes)

    def draw(axes: Axes, link: int) -> None:
        curves = [Curve(name, frequency, amplitude[:, link]) for name, (frequency, amplitude) in spectra.items()]
        for index, (colour, curve) in enumerate(zip(style.CYCLE, curves, strict=False)):
            dashes = DASHES if hides(curves, index) else "-"
            values = np.maximum(curve.values, 0.1 * floor)
            axes.plot(curve.t, values, label=curve.name, color=colour, lw=1.2, ls=dashes)
        if uniform < 4:
            axes.text(0.5, 0.5, "too few samples", transform=axes.transAxes, ha="center", color=style.FAINT)
        axes.set_yscale("log")
        axes.set_ylim(floor, 2 * top)
        axes.yaxis.set_major_locator(LogLocator(numticks=decades + 2))
        axes.yaxis.minorticks_off()
        axes.set_xlim(0, last)

    labels = ("frequency [Hz]", "amplitude [rad]" if flat else "amplitude [-]")
    if flat:
        what = "amplitude spectrum of the link angles"
    else:
        what = "amplitude spectrum of the link directions"
    return panels.grid(run, path, what, chosen_links(run, panels.MOST), draw, labels, share=True)


def _system_spectra(run: Run, path: str | Path) -> Path:
    """Spectra of the tensions at the ends of lines, of the motion and of the surface, a panel each; in waves also the
    vertical motion over the surface."""
    spectra = [_spectra(panel) for panel in (ends_panel(run), *motion_panels(run))]
    shown = [*spectra, *_heave_ratio(spectra)]
    figure = style.new_figure(8.5, 1.2 + 1.75 * len(shown))
    all_axes = style.panels(figure, len(shown), sharex=True)
    for axes, panel in zip(all_axes, shown, strict=True):
        draw_panel(axes, panel)
        axes.set_ylabel(panel.label)
        axes.set_title(panel.title, loc="left", fontsize=9)
        if any(curve.name for curve in panel.curves):
            legend(axes)
    firsts = [panel.curves[0] for panel in spectra]
    last = np.median([_last_frequency(curve.t, curve.values[None, :, None]) for curve in firsts])
    all_axes[-1].set(xlabel="frequency [Hz]", xlim=(0.0, last))
    figure.align_ylabels()
    return style.finish(figure, run, "amplitude spectra", path)


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


def _heave_ratio(spectra: list[Panel]) -> list[Panel]:
    """Amplitude of the vertical motion over that of the surface where the waves are; empty without waves.

    Powers are averaged over nine frequencies first: the ratio of single ones scatters in irregular waves.
    """
    by_label = {panel.label: panel.curves for panel in spectra}
    band = np.full(9, 1 / 9)
    if not {"surface [m]", "z [m]"} <= by_label.keys() or len(by_label["z [m]"][0].values) < 2 * len(band):
        return []
    power = [np.convolve(curve.values**2, band, "same") for curve in by_label["surface [m]"] + by_label["z [m]"]]
    surface = by_label["surface [m]"][0].values
    waves = surface >= 0.1 * surface.max()
    curves = []
    for curve, own in zip(by_label["z [m]"], power[1:], strict=True):
        curves.append(Curve(curve.name, curve.t[waves], np.sqrt(own[waves] / power[0][waves]), colour=curve.colour))
    return [Panel("ratio [m/m]", curves, "vertical motion over surface elevation, at the frequencies of the waves")]


def _uniform(t: np.ndarray) -> int:
    """Number of samples to use, without a shorter last step at the end of the run."""
    if len(t) < 3:
        return len(t)
    if abs((t[-1] - t[-2]) - (t[1] - t[0])) < 1e-3 * (t[1] - t[0]):
        return len(t)
    return len(t) - 1


#: The frequency axis shows this fraction of the power.
SHOWN_POWER = 0.999


def _last_frequency(frequency: np.ndarray, amplitudes: np.ndarray) -> float:
    """End of the frequency axis [Hz]: slightly above the band with nearly all the power of every link."""
    if frequency[-1] == 0:
        return 1.0
    power = np.cumsum((amplitudes**2).sum(axis=(0, 2)))
    if power[-1] == 0:
        return float(frequency[-1])
    return float(min(frequency[-1], 2 * frequency[np.searchsorted(power, SHOWN_POWER * power[-1])] + 2 * frequency[1]))
