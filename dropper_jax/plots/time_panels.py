"""Panels of curves against time that stay legible: long records as envelope and mean, with a zoom."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from dropper_jax.base.records import names_of
from dropper_jax.plots import figures, marks, scales
from dropper_jax.plots.run import Run
from dropper_jax.plots.style import CYCLE, FAINT

#: Intervals of an envelope, and cycles of a zoom.
INTERVALS = 320
CYCLES = 8
#: Dashes of the later of two curves that look like one, so that both are visible.
DASHES = (0.0, (4.0, 4.0))


class Curve(NamedTuple):
    """One quantity against time: values (k,) at t (k,) [s], and the range (k,) of each sample if it has one."""

    name: str
    t: np.ndarray
    values: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None
    colour: str | None = None

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Minimum and maximum (k,) of each sample."""
        low = self.values if self.low is None else self.low
        high = self.values if self.high is None else self.high
        return low, high

    def part(self, start: float, end: float) -> Curve:
        """The curve between two times, with one sample on either side, so that lines reach the edges."""
        first, last = np.searchsorted(self.t, (start, end))
        kept = slice(max(int(first) - 1, 0), int(last) + 2)
        low, high = self.bounds
        return Curve(self.name, self.t[kept], self.values[kept], low[kept], high[kept], self.colour)


class Panel(NamedTuple):
    """Label with unit, and the series of the panel; `zero` draws the zero line."""

    label: str
    curves: list[Curve]
    title: str = ""
    zero: bool = False


#: Number of turning points above which a panel shows an envelope: 200 waves of five pixels each are still visible.
MAX_TURNS = 400


def history(run: Run, path: str | Path, what: str, panels: list[Panel]) -> Path:
    """Panels one above the other; a long record is an envelope on the left, and a part of it is on the right.

    Both have the same scale, and so have panels of one unit and of similar ranges.
    """
    zoom = None
    width = 8.5
    ratios = [1.0]
    if any(turns(curve.values) > MAX_TURNS for panel in panels for curve in panel.curves):
        zoom = zoom_of(panels)
        width = 11.5
        ratios = [1.55, 1.0]
    figure = figures.new_figure(width, 1.2 + 1.75 * len(panels))
    grid = figure.subplots(len(panels), len(ratios), sharex="col", sharey="row", squeeze=False, width_ratios=ratios)
    above: list[str] = []
    for row, panel in zip(grid, panels, strict=True):
        row[0].set_ylabel(panel.label)
        row[0].set_title(panel.title, loc="left", fontsize=9)
        if zoom is None:
            draw_panel(row[0], panel)
        else:
            draw_panel(row[0], panel, envelope=_shortest(panel, panels))
            row[0].axvspan(*zoom, color=FAINT, alpha=0.25, lw=0)
            draw_panel(row[1], panel, part=zoom)
        names = names_of(panel.curves)
        if any(names) and names != above:
            legend(row[-1])
        above = names
    for unit in {_unit(panel) for panel in panels}:
        scales.share_scales([row[0] for row, panel in zip(grid, panels, strict=True) if _unit(panel) == unit])
    for axes in grid[-1]:
        scales.time_axis(axes, run.t)
    if zoom is not None:
        grid[-1, 1].set_xlim(*zoom)
        notes = filter(None, (panels[0].title, "mean, minimum and maximum"))
        grid[0, 0].set_title("; ".join(notes), loc="left", fontsize=9)
        grid[0, 1].set_title(f"zoom on the maximum, {zoom[0]:.4g} to {zoom[1]:.4g} s", loc="left", fontsize=9)
    figure.align_ylabels()
    return figures.finish(figure, run, what, path)


def _unit(panel: Panel) -> str:
    """The last word of the label, such as `[N]`."""
    return panel.label.rpartition(" ")[2]


def _shortest(panel: Panel, panels: list[Panel]) -> float:
    """Shortest cycle [s] of the panels of one unit, used for all their means; 0 without any."""
    alike = [other for other in panels if _unit(other) == _unit(panel)]
    cycles = [cycle(curve.t, curve.values) for other in alike for curve in other.curves]
    return min((length for length in cycles if length > 0.0), default=0.0)


def legend(axes: Axes) -> None:
    """Place the legend above the right end, where there is no title."""
    figures.legend_above(axes, 4, fontsize=8, handlelength=1.2, columnspacing=1.0, borderaxespad=0.1)


def draw_panel(
    axes: Axes, panel: Panel, envelope: float | None = None, part: tuple[float, float] | None = None
) -> None:
    """Draw all curves of a panel; as an envelope with means over cycles of this length [s], or of a part of the
    time."""
    for index, curve in enumerate(panel.curves):
        if part is not None:
            curve = curve.part(*part)
        t = curve.t
        values = curve.values
        low, high = curve.bounds
        look: dict[str, Any] = {"color": curve.colour or CYCLE[index % len(CYCLE)]}
        line: dict[str, Any] = {**look, "ls": line_style(panel.curves, index), "label": curve.name or None}
        if envelope is not None and len(t) > 2 * INTERVALS:
            t, values, low, high = reduce_samples(t, values, low, high)
            axes.plot(t, _without_beat(t, values, envelope), lw=1.1, **line)
        else:
            axes.plot(t, values, lw=1.0, marker=marks.marker(t), ms=4, **line)
        if np.any(high > low):
            axes.fill_between(t, low, high, alpha=0.28, lw=0, **look)
    if panel.zero:
        axes.axhline(0.0, color=FAINT, lw=0.7, zorder=0.5)
    if part is None:  # a part has the scale of the whole
        scales.widen(np.concatenate([curve.values for curve in panel.curves]), axes.set_ylim)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.margins(y=0.08)


#: Two curves closer than this fraction of the maximum range look like one.
LIKE_ONE = 0.01


def line_style(curves: list[Curve], index: int) -> str | tuple[float, tuple[float, float]]:
    """Dashes for a curve that hides a previous one, as in a symmetric farm, else a line."""
    this = curves[index].values
    ranges = [np.ptp(curve.values) for curve in curves if np.all(np.isfinite(curve.values))]
    near = LIKE_ONE * max(ranges, default=0.0)
    for other in curves[:index]:
        if other.values.shape == this.shape and np.max(np.abs(other.values - this), initial=0.0) < near:
            return DASHES
    return "-"


def reduce_samples(
    t: np.ndarray, values: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times, mean, minimum and maximum (m,) of `INTERVALS` stretches of samples (k,), k > INTERVALS."""
    starts = np.unique(np.linspace(0, len(t), INTERVALS, endpoint=False).astype(int))
    count = np.diff(starts, append=len(t))
    mean = np.add.reduceat(values, starts) / count
    at = np.add.reduceat(t, starts) / count
    return at, mean, np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)


def _without_beat(t: np.ndarray, mean: np.ndarray, period: float) -> np.ndarray:
    """Moving average of the means (m,) of stretches about as long as a cycle: single means beat with the cycles."""
    stretch = (t[-1] - t[0]) / (len(t) - 1)
    if 4 * stretch < period:
        return mean
    half = min(int(np.ceil(2 * CYCLES * max(period, stretch) / stretch / 2)), len(mean) // 8)
    window = np.ones(2 * half + 1)
    return np.convolve(mean, window, mode="same") / np.convolve(np.ones_like(mean), window, mode="same")


#: Relative change of a series below which it is rounding.
CONSTANT_CHANGE = 1e-6


def turns(values: np.ndarray) -> int:
    """Number of reversals of a series (k,) by more than about 3 % of its range."""
    known = values[np.isfinite(values)]
    if known.size < 3 or np.ptp(known) <= CONSTANT_CHANGE * np.abs(known).max():
        return 0
    changes = np.diff(np.rint((known - known.min()) / (0.03 * np.ptp(known))))
    signs = np.sign(changes[changes != 0])
    return int(np.sum(signs[1:] != signs[:-1]))


def zoom_of(panels: list[Panel]) -> tuple[float, float]:
    """Part of the time [s] around the maximum of the first panel, a few of its cycles long."""
    first = max(panels[0].curves, key=lambda curve: np.nanmax(curve.bounds[1]))
    t = first.t
    span = t[-1] - t[0]
    period = max((cycle(c.t, c.values) for panel in panels for c in panel.curves), default=span)
    width = min(max(CYCLES * period, 20 * span / max(len(t) - 1, 1)), span / 3)
    peak = t[np.nanargmax(first.bounds[1])]
    start = min(max(peak - width / 2, t[0]), t[-1] - width)
    return start, start + width


def cycle(t: np.ndarray, values: np.ndarray) -> float:
    """Mean time between upward crossings of the mean [s]; 0 if there are fewer than two."""
    above = values > np.nanmean(values)
    up = np.flatnonzero(above[1:] & ~above[:-1])
    if len(up) > 1:
        return (t[up[-1]] - t[up[0]]) / (len(up) - 1)
    return 0.0
