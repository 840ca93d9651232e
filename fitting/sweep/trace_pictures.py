"""Pictures of a sweep whose cases are scored against a trace: maps of the error, curves and spectra."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from dropper_jax.plots import figures, scales, style, tension_colours
from fitting.sweep.scores import TRACE_PARTS, FittedScore, TraceScores

#: Draws one panel: axes, scores, the fit, the part.
DrawPanel = Callable[[Axes, TraceScores, FittedScore | None, int], None]
#: Height of a map [in]: about as high as wide.
MAP_HEIGHT = 3.4
#: Height of a curve or spectrum [in], and that in pictures with more rows than `TALL_ROWS`, which would be too long.
TALL_HEIGHT = 2.5
LOW_HEIGHT = 1.7
#: Number of rows of panels, those of the picture with maps, above which panels are lower.
TALL_ROWS = 3
#: Maximum number of links with a row of their own: a picture with more rows does not fit on a screen.
MOST_LINKS = 9
#: Maximum frequency of a spectrum [Hz]: links of droppers swing slower.
MAX_FREQUENCY = 6.0


class Row(NamedTuple):
    """A row of panels, one for each part of the trace, and its height [in]."""

    draw: DrawPanel
    height: float


def draw_against_trace(scores: TraceScores, folder: str | Path, fit: FittedScore | None = None) -> list[Path]:
    """Pictures of cases scored against a trace, with the fit if given.

    `scores.png` shows maps of the angle error over the varied inputs, with curves and spectra of the link that moves
    most, for head, middle and tail. `curves.png` and `spectra.png` show those of all links.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    links = range(min(scores.simulated.shape[1], MOST_LINKS))
    busiest = int(np.argmax(np.std(scores.against.interpolated[scores.against.part(0)], axis=0)))
    height = LOW_HEIGHT if len(links) > TALL_ROWS else TALL_HEIGHT
    files = {
        "scores": [
            Row(_draw_map, MAP_HEIGHT),
            Row(partial(_draw_curves, link=busiest), TALL_HEIGHT),
            Row(partial(_draw_spectra, link=busiest), TALL_HEIGHT),
        ],
        "curves": [Row(partial(_draw_curves, link=link), height) for link in links],
        "spectra": [Row(partial(_draw_spectra, link=link), height) for link in links],
    }
    return [_rows_by_part(scores, fit, rows, folder / f"{name}.png") for name, rows in files.items()]


@style.plot_style()
def _rows_by_part(scores: TraceScores, fit: FittedScore | None, rows: Sequence[Row], path: Path) -> Path:
    """Rows of three panels: head, middle, tail."""
    many = len(rows) > TALL_ROWS
    heights = [row.height for row in rows]
    whole = 1.6 + sum(heights)
    figure = figures.new_figure(13.0, whole, layout=None)  # a constrained layout takes seconds for so many panels
    gap = 0.62
    if many:  # only the last row has labels of its axes
        gap = 0.3
    space = {
        "left": 0.06,
        "right": 0.98,
        "bottom": 0.55 / whole,
        "top": 1.0 - 0.95 / whole,
        "wspace": 0.2,
        "hspace": gap * len(rows) / sum(heights),
    }
    grid = figure.subplots(len(rows), len(TRACE_PARTS), squeeze=False, height_ratios=heights, gridspec_kw=space)
    for i, row in enumerate(rows):
        for part, axes in enumerate(grid[i]):
            row.draw(axes, scores, fit, part)
            if many and i + 1 < len(rows):
                axes.set_xlabel("")
    _title_parts(grid[0], scores, fit)
    below_map = grid[min(1, len(rows) - 1), 0]
    figure.legend(*below_map.get_legend_handles_labels(), loc="upper right", ncols=3, markerscale=4)
    figures.title(figure, f"{scores.sweep.plan.scene.name} against {scores.against.trace.name}")
    figure.align_ylabels()
    return figures.save(figure, path)


def _title_parts(top: Sequence[Axes], scores: TraceScores, fit: FittedScore | None) -> None:
    """Name, span and angle errors of each part over its panel in the top row."""
    limits = (0.0, *scores.against.ends)
    for part, axes in enumerate(top):
        error = f"angle error: best case {1e3 * scores.angle[scores.best, part]:.3g} mrad"
        fitted = "" if fit is None else f", fit {1e3 * fit.angle[part]:.3g} mrad"
        title = f"{TRACE_PARTS[part]}, {limits[part]:.4g} to {limits[part + 1]:.4g} s"
        axes.set_title(f"{title}\n{error}{fitted}", loc="left", fontsize=9)


class Simulated(NamedTuple):
    """A line over the measured curve: its name, angles (k, n) [rad], colour and width."""

    name: str
    angles: np.ndarray
    colour: str
    width: float


def _named_values(scores: TraceScores, values: np.ndarray) -> str:
    """Values (inputs,) of the varied inputs as text, each after the last part of its path."""
    words = []
    for path, value in zip(scores.paths, values, strict=True):
        words.append(f"{short_path(path.rsplit('.', 1)[-1])} {value:.4g}")
    return ", ".join(words)


def _simulated_lines(scores: TraceScores, fit: FittedScore | None) -> list[Simulated]:
    """The lines of the best case and the fit, with the measured number of turns."""
    best = _named_values(scores, scores.values[scores.best])
    found = [Simulated(f"best case: {best}", scores.simulated, style.SECOND, 1.2)]
    if fit is not None and np.isfinite(fit.simulated).all():
        found.append(Simulated(f"fit: {_named_values(scores, fit.values)}", fit.simulated, style.FIRST, 1.0))
    turned = []
    for line in found:
        turns = np.round((scores.against.interpolated[0] - line.angles[0]) / (2 * np.pi))
        turned.append(line._replace(angles=line.angles + 2 * np.pi * turns))
    return turned


def _draw_curves(axes: Axes, scores: TraceScores, fit: FittedScore | None, part: int, link: int) -> None:
    """Angle of a link over time, measured and simulated."""
    against = scores.against
    inside = against.part(part)
    t = against.t[inside]
    axes.plot(t, against.measured[inside, link], ".", ms=1.6, color=style.DARK, label="measured")
    for name, x, colour, width in _simulated_lines(scores, fit):
        axes.plot(t, x[inside, link], color=colour, lw=width, label=name)
    scales.time_axis(axes, t)
    if part == 0:
        axes.set_ylabel(f"link {link + 1} [rad]")


def _draw_spectra(axes: Axes, scores: TraceScores, fit: FittedScore | None, part: int, link: int) -> None:
    """Amplitude spectrum of the angle of a link, measured and simulated."""
    against = scores.against
    measured = ("measured", against.interpolated, style.DARK, 1.6)
    for name, x, colour, width in (measured, *_simulated_lines(scores, fit)):
        frequency, amplitude = against.spectrum(x, part)
        axes.plot(frequency, amplitude[:, link], color=colour, lw=width, label=name)
    axes.set(xlabel="frequency [Hz]", xlim=(0.0, min(MAX_FREQUENCY, frequency[-1])), ylim=(0.0, None))
    if part == 0:
        axes.set_ylabel(f"link {link + 1}, spectrum [rad]")


def _draw_map(axes: Axes, scores: TraceScores, fit: FittedScore | None, part: int) -> None:
    """RMS angle error over the first one or two varied inputs; the best over the other inputs."""
    axes.set_xlabel(_label(scores, 0))
    _set_log_scale(axes.set_xscale, scores.values[:, 0])
    if scores.values.shape[1] == 1:
        _draw_error_curve(axes, scores, fit, part)
    else:
        _draw_error_map(axes, scores, fit, part)


def _draw_error_curve(axes: Axes, scores: TraceScores, fit: FittedScore | None, part: int) -> None:
    """RMS angle error [rad] over the only varied input."""
    x = scores.values[:, 0]
    error = scores.angle[:, part]
    order = np.argsort(x)
    axes.plot(x[order], error[order], "o-", ms=3.5, color=style.FAINT, label="cases")
    axes.plot(x[scores.best], error[scores.best], "o", ms=9, mfc="none", mew=1.8, color=style.SECOND)
    if fit is not None:
        axes.errorbar(fit.values[0], fit.angle[part], xerr=fit.errors[0], fmt="*", ms=16, color=style.FIRST)
    axes.set_yscale("log")
    if part == 0:
        axes.set_ylabel("angle error [rad]")


def _draw_error_map(axes: Axes, scores: TraceScores, fit: FittedScore | None, part: int) -> None:
    """RMS angle error [mrad] as the colour of cases, over the first two varied inputs."""
    x = scores.values[:, 0]
    y = scores.values[:, 1]
    error = scores.angle[:, part]
    order = np.argsort(-error)  # the best on top
    size = np.clip(2.2e4 / len(x), 12.0, 150.0)
    marker = "s" if size < 100.0 else "o"
    colours = tension_colours.tension_map()
    points = axes.scatter(x[order], y[order], s=size, marker=marker, c=1e3 * error[order], cmap=colours, norm=LogNorm())
    bar = axes.figure.colorbar(points, ax=axes)
    if part == len(TRACE_PARTS) - 1:
        bar.set_label("RMS angle error [mrad]")
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    bar.ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    bar.ax.yaxis.set_minor_formatter(NullFormatter())
    axes.plot(x[scores.best], y[scores.best], "o", ms=16, mfc="none", mew=1.8, color=style.SECOND)
    if fit is not None:
        fitted = fit.values[:2]
        spread = fit.errors[:2]
        axes.errorbar(*fitted, xerr=spread[0], yerr=spread[1], fmt="*", ms=16, color=style.FIRST, mec="white")
        y = np.append(y, fit.values[1])
    _set_log_scale(axes.set_yscale, y)
    if part == 0:
        axes.set_ylabel(_label(scores, 1))


def _label(scores: TraceScores, axis: int) -> str:
    """A varied input's path, with its unit if it has one."""
    varied = scores.sweep.plan.axes[axis]
    label = short_path(varied.path)
    if varied.unit:
        label = f"{label} [{varied.unit}]"
    return label


def _set_log_scale(set_scale: Callable[..., None], values: np.ndarray) -> None:
    """A logarithmic axis if values span more than a factor of ten; zero is drawn left of the minimum positive value."""
    positive = values[values > 0]
    if (values < 0).any() or not len(positive) or positive.max() < 10 * positive.min():
        return
    if (values == 0).any():
        set_scale("symlog", linthresh=float(positive.min()))
    else:
        set_scale("log")


def short_path(name: object) -> str:
    """A dimension or path without the section `effects`, for labels."""
    return str(name).removeprefix("effects.")
