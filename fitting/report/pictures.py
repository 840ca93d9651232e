"""Pictures of a fit: traces, residuals, spectra, phase space."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dropper_jax.analysis.spectrum import amplitude_spectrum
from dropper_jax.plots import figures, scales, style
from fitting.calibration.held_out import HeldOut
from fitting.calibration.prediction import Prediction
from fitting.calibration.result import FitResult
from fitting.traces.noise import column_medians
from fitting.traces.planar import wrap

#: Maximum number of links in one picture; the title reports how many are left out.
MOST_LINKS_DRAWN = 9
#: Maximum frequency of a spectrum [Hz], and its lowest amplitude [rad], so that the logarithm exists.
MAX_FREQUENCY = 8.0
LEAST_AMPLITUDE = 1e-7
#: Missing samples that interrupt a line.
GAP_SAMPLES = 5


def fit_over_trace(result: FitResult | HeldOut, run: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (m,), measured angles, NaN if missing, and simulated ones (m, n) [rad] of one run's windows in order."""
    windows = result.windows
    mine = windows.run == run
    known = windows.weight[mine] > 0
    used = known.any(axis=2)
    measured = windows.theta[mine][used]
    simulated = measured + wrap(result.solution.evaluation.theta[mine][used] - measured)
    t = windows.times()[mine][used]
    order = np.argsort(t, kind="stable")  # recordings of one motion follow each other in a window
    return t[order], np.where(known[used], measured, np.nan)[order], simulated[order]


def gaps(t: np.ndarray, interval: float) -> np.ndarray:
    """Numbers of the times (m,) that follow a gap.

    Args:
        interval: between samples [s]; times of several recordings may lie closer together, or be the same.
    """
    return np.flatnonzero(np.diff(t) > GAP_SAMPLES * interval) + 1


def with_gaps(t: np.ndarray, x: np.ndarray, interval: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and values with NaN in every gap, so that no line is drawn through unfitted stretches."""
    after = gaps(t, interval)
    return np.insert(t, after, np.nan), np.insert(x, after, np.nan, axis=0)


def link_panels(links: int, title: str, height: float = 1.3, margin: float = 1.2) -> tuple[Figure, np.ndarray]:
    """A figure with one panel for each link, up to `MOST_LINKS_DRAWN`."""
    drawn = min(links, MOST_LINKS_DRAWN)
    figure = figures.new_figure(9.0, margin + height * drawn)
    axes = figures.panels(figure, drawn, sharex=True)
    more = f" (links 1 to {drawn} of {links})" if links > drawn else ""
    figures.title(figure, f"{title}{more}")
    for j, ax in enumerate(axes):
        ax.set_ylabel(f"link {j + 1}")
    return figure, axes


def traces(result: FitResult, run: int) -> Figure:
    """Measured angles and the fit, per link [rad from the horizontal]."""
    t, measured, simulated = fit_over_trace(result, run)
    figure, axes = link_panels(
        measured.shape[1], f"{result.traces[run].name}: traces and fit [rad from the horizontal]"
    )
    # each stretch starts from its own angles, with the parameters of the fit
    interval = result.traces[run].interval
    t_fit, fitted = with_gaps(t, simulated, interval)
    held = [fit_over_trace(h, run) for h in result.held_out if (h.windows.run == run).any()]
    for j, ax in enumerate(axes):
        ax.plot(t_fit, fitted[:, j], lw=1.6, color=style.FIRST, label="fit")
        label = "held out, predicted"
        for t1, _, predicted in held:
            ax.plot(*with_gaps(t1, predicted[:, j], interval), lw=1.6, color=style.SECOND, label=label)
            label = None  # once in the legend
        ax.plot(t, measured[:, j], ".", ms=1.0, color=style.DARK, label="measured")
        for t1, seen, _ in held:
            ax.plot(t1, seen[:, j], ".", ms=1.0, color=style.DARK)
    figures.legend_above(axes[0], 3, markerscale=4)
    scales.time_axis(axes[-1], np.sort(np.concatenate([t, *(h[0] for h in held)])))
    return figure


def residuals(result: FitResult, run: int) -> Figure:
    """Measured minus fitted angles, per link [rad]; the band is twice their standard deviation."""
    t, measured, simulated = fit_over_trace(result, run)
    figure, axes = link_panels(measured.shape[1], f"{result.traces[run].name}: residuals [rad]", 1.0)
    rest = measured - simulated
    band = 2 * np.nanstd(rest)
    for j, ax in enumerate(axes):
        ax.axhspan(-band, band, color=style.LIGHT, lw=0, label="2 standard deviations of all links")
        ax.plot(t, rest[:, j], ".", ms=1.5, color=style.SECOND)
    figures.legend_above(axes[0])
    scales.time_axis(axes[-1], t)
    return figure


def first_drawn(axes: np.ndarray) -> Axes:
    """The first panel with curves: a recording may show nothing of a link."""
    return next((ax for ax in axes if ax.lines), axes[0])


def spectra(result: FitResult, run: int) -> Figure:
    """Amplitude spectra of measured and fitted angles, per link [rad], of the longest stretch without a gap."""
    t, measured, simulated = fit_over_trace(result, run)
    figure, axes = link_panels(measured.shape[1], f"{result.traces[run].name}: amplitude spectra [rad]")
    edges = [0, *gaps(t, result.traces[run].interval), len(t)]
    low, high = max(pairwise(edges), key=lambda ends: ends[1] - ends[0])
    longest = slice(low, high)
    t = t[longest]
    measured = measured[longest]
    simulated = simulated[longest]
    grid = np.linspace(t[0], t[-1], len(t))
    highest = MAX_FREQUENCY
    for j, ax in enumerate(axes):
        known = np.isfinite(measured[:, j])
        if not known.any():  # a recording that shows nothing of this link
            continue
        for x, colour, label in ((measured[:, j], style.FAINT, "measured"), (simulated[:, j], style.FIRST, "fit")):
            frequency, amplitude = amplitude_spectrum(grid, np.interp(grid, t[known], x[known]))
            ax.semilogy(frequency[1:], np.maximum(amplitude[1:], LEAST_AMPLITUDE), lw=0.9, color=colour, label=label)
            highest = min(highest, frequency[-1])
    figures.legend_above(first_drawn(axes), 2)
    axes[-1].set_xlabel("frequency [Hz]")
    axes[-1].set_xlim(0, highest)
    return figure


def phase_space(result: FitResult, run: int) -> Figure:
    """Rate over angle of every link, measured (differences) and fitted."""
    t, measured, simulated = fit_over_trace(result, run)
    links = min(measured.shape[1], MOST_LINKS_DRAWN)
    columns = min(links, 4)
    figure = figures.new_figure(max(2.6 * columns + 0.6, 5.4), 2.5 * -(-links // columns) + 0.8)
    axes = figures.panels(figure, links, columns)
    for j, ax in enumerate(axes):
        ax.set_title(f"link {j + 1}")
        known = np.isfinite(measured[:, j])  # rows of one recording: those of others may have the same times
        if known.sum() < 2:
            continue
        for x, colour, label in ((measured, style.SECOND, "measured"), (simulated, style.FIRST, "fit")):
            times, angles = with_gaps(t[known], x[known, j], result.traces[run].interval)
            ax.plot(angles, np.gradient(angles, times), lw=0.6, color=colour, label=label)
    figure.legend(*first_drawn(axes).get_legend_handles_labels(), loc="upper right", ncols=2)
    figures.title(figure, f"{result.traces[run].name}: phase space")
    figure.supxlabel("angle [rad]", fontsize=9)
    figure.supylabel("rate [rad/s]", fontsize=9)
    return figure


def descent(result: FitResult) -> Figure:
    """Loss per sample and parameters in each step of a gradient descent, of all runs together."""
    points = result.descent
    parameters = result.parameters[:MOST_LINKS_DRAWN]
    step = np.arange(len(points))
    figure = figures.new_figure(9.0, 1.8 + 1.5 * (1 + len(parameters)))
    axes = figure.subplots(1 + len(parameters), 1, sharex=True)
    axes[0].semilogy(step, [point["loss"] for point in points], ".-", ms=4, lw=1, color=style.FIRST)
    axes[0].set_ylabel("loss per sample")
    for i, (p, ax) in enumerate(zip(parameters, axes[1:], strict=True)):
        ax.plot(step, [point["values"][i] for point in points], ".-", ms=4, lw=1, color=style.SECOND)
        ax.set_ylabel(f"{p.name.split('.')[-1]} [{p.unit}]")
    weights = [point["gap_weight"] for point in points]
    for i in np.flatnonzero([a != b for a, b in pairwise(weights)]) + 1:
        for ax in axes:
            ax.axvline(i - 0.5, color=style.FAINT, lw=0.8)
        axes[0].annotate(
            f"{weights[i]:g}", (i - 0.5, 0.97), (2, 0), ("data", "axes fraction"), "offset points", va="top", fontsize=7
        )
    axes[-1].set_xlabel("step; lines: windows are joined with the gap weight written there")
    figures.title(figure, "descent")
    return figure


@style.plot_style()
def one_run_picture(found: Prediction, name: str, path: Path) -> Path:
    """Measured angles and the run, per link [rad from the horizontal]; faint beyond the prediction horizon."""
    title = f"{name}: one run over the trace [rad from the horizontal]"
    figure, axes = link_panels(found.measured.shape[1], title, margin=1.5)
    good = found.t <= found.trusted
    # whole turns are removed once, where the run is reliable
    turns = np.nan_to_num(column_medians((found.measured - found.simulated)[good])) / (2 * np.pi)
    simulated = found.simulated + 2 * np.pi * np.round(turns)
    beyond = {"lw": 0.8, "color": style.FIRST, "alpha": 0.55, "label": "beyond the prediction horizon"}
    for j, ax in enumerate(axes):
        ax.plot(found.t, found.measured[:, j], ".", ms=1.2, color=style.DARK, label="measured")
        ax.plot(found.t[good], simulated[good, j], lw=1.4, color=style.FIRST, label="one run")
        if not good.all():
            ax.plot(found.t[~good], simulated[~good, j], **beyond)
            ax.axvline(found.trusted, color=style.SECOND, lw=1.0, ls="--")
    figures.legend_above(axes[0], 3, markerscale=4)
    scales.time_axis(axes[-1], found.t)
    return figures.save(figure, path)


#: Pictures of a run of a fit, by the names of their files.
PICTURES = {"traces": traces, "residuals": residuals, "spectra": spectra, "phase_space": phase_space}
