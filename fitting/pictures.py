"""Pictures of a fit: traces, residuals, spectra, phase space."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure

from dropper_jax.analysis.spectrum import amplitude_spectrum
from dropper_jax.plots import style
from fitting.result import FitResult

#: Most links drawn in one picture; the others are left out, and the title says so.
MOST = 8


def fitted(result: FitResult, run: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times (m,), measured and simulated angles (m, n) [rad] and which are known, of one run's windows in order."""
    w, e = result.windows, result.solution.evaluation
    mine = w.run == run
    known = (w.weight[mine] > 0).reshape(-1, w.theta.shape[2])
    used = known.any(axis=1)
    t = w.times()[mine].reshape(-1)[used]
    measured = w.theta[mine].reshape(-1, w.theta.shape[2])[used]
    simulated = e.theta[mine].reshape(-1, w.theta.shape[2])[used]
    simulated = simulated - 2 * np.pi * np.round((simulated - measured) / (2 * np.pi))
    return t, np.where(known[used], measured, np.nan), simulated, known[used]


def _styled(draw: Callable[..., Figure]) -> Callable[..., Path]:
    @wraps(draw)
    def wrapper(result: FitResult, run: int, path: Path) -> Path:
        with matplotlib.style.context(["default", style.RC]):
            return style.save(draw(result, run), path)

    return wrapper


def _rows(result: FitResult, what: str, height: float = 1.3) -> tuple[Figure, np.ndarray, int]:
    links = min(result.windows.theta.shape[2], MOST)
    figure = style.new_figure(9.0, 1.2 + height * links)
    axes = figure.subplots(links, 1, sharex=True, squeeze=False)[:, 0]
    all_links = result.windows.theta.shape[2]
    more = f" (links 1 to {links} of {all_links})" if all_links > links else ""
    figure.suptitle(f"{what}{more}", fontsize=12, fontweight="bold", x=0.01, ha="left")
    return figure, axes, links


@_styled
def traces(result: FitResult, run: int) -> Figure:
    """Measured angles and the fit, per link [rad from the horizontal]."""
    figure, axes, links = _rows(result, f"{result.traces[run].name}: traces and fit")
    t, measured, simulated, _ = fitted(result, run)
    for j in range(links):
        axes[j].plot(t, measured[:, j], ".", ms=1.5, color=style.FAINT, label="measured")
        axes[j].plot(t, simulated[:, j], lw=0.8, color=style.FIRST, label="fit")
        axes[j].set_ylabel(f"link {j + 1}")
    axes[0].legend(loc="upper right", ncols=2, markerscale=4)
    style.time_axis(axes[-1], t)
    return figure


@_styled
def residuals(result: FitResult, run: int) -> Figure:
    """Measured less fitted angles, per link [rad]; the band is twice their deviation."""
    figure, axes, links = _rows(result, f"{result.traces[run].name}: residuals", 1.0)
    t, measured, simulated, _ = fitted(result, run)
    rest = measured - simulated
    deviation = np.nanstd(rest)
    for j in range(links):
        axes[j].axhspan(-2 * deviation, 2 * deviation, color="#E3E5E8", lw=0)
        axes[j].plot(t, rest[:, j], ".", ms=1.5, color=style.SECOND)
        axes[j].set_ylabel(f"link {j + 1}")
    style.time_axis(axes[-1], t)
    return figure


@_styled
def spectra(result: FitResult, run: int) -> Figure:
    """Amplitude spectra of measured and fitted angles, per link [rad]."""
    figure, axes, links = _rows(result, f"{result.traces[run].name}: amplitude spectra")
    t, measured, simulated, _ = fitted(result, run)
    grid = np.linspace(t[0], t[-1], len(t))
    for j in range(links):
        known = np.isfinite(measured[:, j])
        for x, colour, label in ((measured[:, j], style.FAINT, "measured"), (simulated[:, j], style.FIRST, "fit")):
            even = np.interp(grid, t[known], x[known])
            frequency, amplitude = amplitude_spectrum(grid, even)
            axes[j].semilogy(frequency[1:], np.maximum(amplitude[1:], 1e-7), lw=0.9, color=colour, label=label)
        axes[j].set_ylabel(f"link {j + 1}")
    axes[0].legend(loc="upper right", ncols=2)
    axes[-1].set_xlabel("frequency [Hz]")
    axes[-1].set_xlim(0, min(8.0, frequency[-1]))
    return figure


@_styled
def phase_space(result: FitResult, run: int) -> Figure:
    """Rate against angle of every link, measured (differences) and fitted."""
    t, measured, simulated, _ = fitted(result, run)
    links = min(measured.shape[1], MOST)
    columns = min(links, 4)
    figure = style.new_figure(2.6 * columns + 0.6, 2.5 * -(-links // columns) + 0.5)
    axes = figure.subplots(-(-links // columns), columns, squeeze=False).ravel()
    for j in range(links):
        for x, colour in ((measured[:, j], style.FAINT), (simulated[:, j], style.FIRST)):
            axes[j].plot(x, np.gradient(x, t), lw=0.5, color=colour)
        axes[j].set_title(f"link {j + 1}")
    for extra in axes[links:]:
        extra.set_visible(False)
    figure.supxlabel("angle [rad]", fontsize=9)
    figure.supylabel("rate [rad/s]", fontsize=9)
    return figure


PICTURES = {"traces": traces, "residuals": residuals, "spectra": spectra, "phase_space": phase_space}
