"""Tensions along lines: of a configuration at rest, and their ranges over a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from dropper_jax.load.scene import Scene
from dropper_jax.plots import figures, panels, scales, style
from dropper_jax.plots.run import Run
from dropper_jax.plots.scales import force_unit
from dropper_jax.plots.style import CYCLE, DARK, FAINT
from dropper_jax.plots.surroundings import SURFACE, WATER
from dropper_jax.plots.tension import scale_tensions
from dropper_jax.quantities.bending import curvature
from dropper_jax.scene import whole_lines

#: Maximum number of lines in one picture, each with its own colour.
MAX_LINES = len(CYCLE)


@style.plot_style()
def along_lines(scene: Scene, positions: np.ndarray, tension: np.ndarray, path: str | Path) -> Path:
    """Tension [N or kN] and curvature [1/m] over the arc length of the lines with the most tension, at equilibrium.

    Args:
        positions: all nodes (nodes, 3) [m]; tension: (n,) [N].
    """
    bent = curvature(scene, positions[None])[0]
    bent[bent == 0.0] = np.nan  # ends, and points that cut a line
    every = whole_lines(scene)
    lines = sorted(every, key=lambda line: -tension[line.links].max())[:MAX_LINES]
    unit, size = force_unit(tension)
    figure = figures.new_figure(7.5, 4.8)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for i, (colour, line) in enumerate(zip(CYCLE, lines, strict=False)):
        dashes = "--" if i % 2 else "-"  # equal lines hide each other
        mark = {"marker": "o", "ms": 2.5, "color": colour, "ls": dashes}
        arc = np.concatenate([[0.0], np.cumsum(line.spec.length)])
        upper.plot(arc[1:] - 0.5 * line.spec.length, tension[line.links] / size, label=line.name, **mark)
        lower.plot(arc, bent[line.nodes], **mark)
    upper.set_ylabel(f"tension [{unit}]")
    lower.set(xlabel="unstretched arc length [m]", ylabel="curvature [1/m]")
    figures.legend_above(upper, 4, "left", borderaxespad=0.2)
    if len(lines) < len(every):
        figures.title(figure, f"{scene.name}: the {len(lines)} most loaded lines of {len(every)}")
    return figures.save(figure, path)


@style.with_style
def tension_envelope(run: Run, path: str | Path) -> Path:
    """Minimum, mean and maximum tension along the line; of several lines a panel for each of the 12 most loaded.

    Lines of similar loads (within a factor of 4) have the same scale.
    """
    scaled = scale_tensions(run)
    sizes = [np.max(scaled.high[:, line.links]) for line in run.written_lines]
    shown = [run.written_lines[i] for i in sorted(np.argsort(sizes)[::-1][: panels.MAX_TRACES])]
    total = len(run.written_lines)
    what = "tension envelope"
    if len(shown) < total:
        what = f"{what} of the {len(shown)} most loaded lines of {total}"
    columns = min(len(shown), 2)
    rows = -(-len(shown) // columns)
    height = 4.2 if rows == 1 else 1.0 + 1.9 * rows
    figure = figures.new_figure(4.0 + 3.5 * columns, height)
    all_axes = figures.panels(figure, len(shown), columns)
    for axes, line in zip(all_axes, shown, strict=True):
        own = run.lengths[line.links]
        parts = (tensions[:, line.links] for tensions in (scaled.tension, scaled.low, scaled.high))
        _envelope(axes, np.cumsum(own) - 0.5 * own, *parts)
        if len(shown) > 1:
            axes.set_title(line.name, loc="left")
    scales.share_scales(all_axes)
    figures.outer_labels(all_axes, columns, "arc length [m]", f"tension [{scaled.unit}]")
    if len(shown) == 1:
        figures.legend_above(all_axes[0], 4, "left")
    else:
        figures.legend_below(figure, all_axes[0], 4)
    return figures.finish(figure, run, what, path)


def _envelope(axes: Axes, s: np.ndarray, tension: np.ndarray, least: np.ndarray, largest: np.ndarray) -> None:
    """Tension (k, n) against the arc length (n,) of the middle of each link [m]."""
    shares = (5, 25, 75, 95)
    percentiles = dict(zip(shares, np.percentile(tension, shares, axis=0), strict=True))
    draw_bands(axes, s, (least.min(axis=0), largest.max(axis=0)), percentiles)
    axes.plot(s, tension.mean(axis=0), "-o", color=DARK, ms=3.5, label="mean")
    axes.axhline(0.0, color=FAINT, lw=0.7)
    axes.xaxis.set_major_locator(MaxNLocator(8))


def draw_bands(axes: Axes, s: np.ndarray, full: Sequence[np.ndarray], percentiles: dict[int, np.ndarray]) -> None:
    """Ranges of tensions (n,) at the arc lengths s (n,) [m]: minimum and maximum, and the percentiles 5, 25, 75, 95."""
    axes.fill_between(s, full[0], full[1], color=WATER, label="minimum to maximum")
    for low, high, shade in ((5, 95, 0.35), (25, 75, 0.6)):
        band = (percentiles[low], percentiles[high])
        axes.fill_between(s, *band, color=SURFACE, alpha=shade, lw=0, label=f"{low} to {high} %")
