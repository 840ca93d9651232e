"""Pictures of water and of lines in it: elevation, line and surface, response of a link, tension envelope, the current
from above, and the range of validity of the wave theories.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from dropper_jax.load.surface import bed_height
from dropper_jax.plots import figures, marks, panels, scales, style, view
from dropper_jax.plots.motion import uniform_spectrum
from dropper_jax.plots.run import ANGLE_ROUNDING, Run, elevations, swing
from dropper_jax.plots.scales import force_unit
from dropper_jax.plots.style import ALERT, CYCLE, DARK, FAINT, SECOND
from dropper_jax.plots.system import BED, SURFACE, WATER, draw_solids
from dropper_jax.run.wakes import SceneWakes
from dropper_jax.sea.dispersion import wave_number
from dropper_jax.sea.spec import SeaSpec
from dropper_jax.sea.steady import LINEAR_MAX_HARMONIC, STOKES_MAX_HEIGHT, STOKES_MAX_LENGTH, highest, second_harmonic


@style.plot_style()
def regimes(waves: Sequence[tuple[str, float, float, float]], gravity: float, path: str | Path) -> Path:
    """Areas of linear, Stokes V and stream function waves up to breaking.

    Lengths along the lines are those of linear waves; the theory of a wave is chosen by its own length.

    Args:
        waves: marked ones: label, height [m], period [s], depth [m].
    """
    # drawn range of d/(g T^2)
    depths = np.geomspace(4e-4, 0.3, 300)
    # of linear waves over g T^2
    length = 2.0 * np.pi / np.asarray(wave_number(jnp.full(depths.shape, 2.0 * np.pi), jnp.asarray(depths), 1.0))
    limit = np.vectorize(highest)(length, depths)
    linear = LINEAR_MAX_HARMONIC / np.vectorize(second_harmonic)(1.0, length, depths)
    stokes = np.where(length < STOKES_MAX_LENGTH * depths, STOKES_MAX_HEIGHT * limit, linear)
    figure = figures.new_figure(7.6, 6.2)
    axes = figure.subplots()
    low = min([1e-5, *(0.5 * h / (gravity * t**2) for _, h, t, _ in waves)])
    axes.fill_between(depths, low, linear, color=CYCLE[5], alpha=0.25, label="linear", lw=0)
    axes.fill_between(depths, linear, stokes, color=CYCLE[2], alpha=0.25, label="Stokes V", lw=0)
    axes.fill_between(depths, stokes, limit, color=CYCLE[4], alpha=0.3, label="stream function", lw=0)
    axes.plot(depths, limit, color=ALERT, lw=1.8, label="breaking (Williams 1981)")
    # depth over wavelength above which water is deep, and below which it is shallow
    for share, name in ((0.5, "deep"), (0.05, "shallow")):
        _line(axes, np.interp(-share, -depths[::-1] / length[::-1], depths[::-1]), f"d/L = {share:g}, {name}")
    for i, (label, height, period, depth) in enumerate(waves):
        scale = gravity * period**2
        axes.plot(depth / scale, height / scale, "o", color=CYCLE[1 - i % 2], ms=8, label=label, zorder=5)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="depth d/(g T²)",
        ylabel="height H/(g T²)",
        xlim=(depths[0], depths[-1]),
        ylim=(low, 0.05),
    )
    figure.legend(loc="outside lower center", ncols=3)
    figures.title(figure, "theories of regular waves")
    return figures.save(figure, path)


def _line(axes: Axes, at: float, text: str) -> None:
    """A vertical line with its meaning."""
    axes.axvline(at, color=FAINT, lw=0.9, ls="--")
    axes.annotate(text, (at, 0.03), (4, 0), ("data", "axes fraction"), "offset points", fontsize=8, rotation=90)


@style.plot_style()
def flow_map(name: str, found: SceneWakes, path: str | Path) -> Path:
    """Current [m/s] at the mean height of the lines, along and across it, with the lines' links [m]."""
    wakes = found.wakes
    e = wakes.elements
    height = np.average(e.z, weights=e.drag_coefficient * e.area + 1e-12)
    size = max(np.ptp(e.x), np.ptp(e.y), 10.0)
    x = np.linspace(e.x.min() - 0.1 * size, e.x.max() + 0.8 * size, 90)
    y = np.linspace(e.y.min() - 0.25 * size, e.y.max() + 0.25 * size, 160)
    speed = wakes.velocity(x, y, height)
    figure = figures.new_figure(9.0, 5.6)
    axes = figure.subplots()
    shown = axes.pcolormesh(x, y, speed.T, cmap="viridis", vmin=0.0, vmax=wakes.speed, shading="gouraud")
    axes.plot(e.x, e.y, ".", color="white", ms=2.5, mec=DARK, mew=0.3, label="links")
    axes.set(xlabel="along the current [m]", ylabel="across it [m]", aspect="equal")
    axes.grid(False)
    figure.colorbar(shown, ax=axes, label=f"current at z = {height:.1f} m [m/s]", shrink=0.8)
    figures.title(figure, f"{name}: {wakes.speed:.2f} m/s towards {np.degrees(found.direction):.0f} degrees from x")
    return figures.save(figure, path)


#: Number of points along the surface of a picture.
SURFACE_POINTS = 240


def _sea_of(run: Run) -> SeaSpec:
    """The water of the scene of a run."""
    if run.scene.sea is None:
        raise ValueError(f"solution: scene {run.scene.name!r} has no [sea]. Use a scene with water")
    return run.scene.sea


#: Ratio of height to length below which both views of a system are drawn one above the other.
LOW_AND_LONG = 0.35


@style.with_style
def under_surface(run: Run, path: str | Path, time: float | None = None) -> Path:
    """The line [m] and the surface above it at a time [s] (default: that of the maximum tension), seen from two sides.

    What stays in the plane of x and z is seen from one side only.
    """
    _sea_of(run)
    index = run.sample(time)
    extent = np.ptp(run.positions[index], axis=0)
    half = 0.55 * max(extent.max(), 1.0)
    low_and_long = extent[2] < LOW_AND_LONG * 2 * half
    sides = 1 if view.planar(run.positions) else 2
    columns = sides
    height = 5.6
    if low_and_long:  # one above the other
        columns = 1
        height = 2.6 * sides + 0.4
    figure = figures.new_figure(9.5, height)
    for axis, axes in enumerate(figures.panels(figure, sides, columns, sharey=True)):
        _side_view(axes, run, index, axis, half)
    figure.axes[0].set_ylabel("z [m]")
    if low_and_long:
        figure.axes[-1].set_ylabel("z [m]")
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower left", ncols=4)
    else:
        figure.axes[0].legend(loc="upper left", bbox_to_anchor=(0.0, 1.12), ncols=4)
    return figures.finish(figure, run, f"under the surface at t = {run.t[index]:.2f} s", path)


def _side_view(axes: Axes, run: Run, index: int, axis: int, half: float) -> None:
    """Lines, surface and seabed of a sample over x (0) or y (1), up to `half` [m] from the middle of the lines."""
    nodes = run.positions[index]
    low = nodes.min(axis=0)
    high = nodes.max(axis=0)
    middle = 0.5 * (low + high)
    along = np.linspace(middle[axis] - half, middle[axis] + half, SURFACE_POINTS)
    positions = np.tile(middle, (SURFACE_POINTS, 1))
    positions[:, axis] = along
    eta = elevations(run.scene, positions, run.t[index : index + 1])[0]
    bed = bed_height(run.scene, positions)
    if bed is None:
        lowest = max(low[2] - 0.1 * half, -_sea_of(run).depth)
    else:
        lowest = low[2] - 0.1 * (high - low)[2]
    axes.fill_between(along, eta, lowest, color=WATER)
    if bed is not None and bed.max() > lowest:
        axes.fill_between(along, np.maximum(bed, lowest), lowest, color=BED, label="seabed")
    axes.plot(along, eta, color=SURFACE, label="surface")
    axes.axhline(0.0, color=FAINT, lw=0.7, ls="--")
    label = "line" if len(run.lines) == 1 else "lines"
    for line in run.lines:
        own = nodes[line.nodes]
        axes.plot(own[:, axis], own[:, 2], "-o", color=DARK, ms=max(marks.dot(run) - 0.5, 0.0), label=label)
        label = None
    ends = nodes[list(run.fixed_nodes)]
    axes.plot(ends[:, axis], ends[:, 2], "s", color=SECOND, ms=6, label="fixed points")
    draw_solids(axes, run, index, axis, grow=True)
    axes.set(xlabel=f"{'xy'[axis]} [m]", xlim=(along[0], along[-1]), ylim=(lowest, None), aspect="equal")


@style.with_style
def response(run: Run, path: str | Path) -> Path:
    """Elevation; angles of a link: spectra and phase space, as thesis figures 8.32 to 8.34.

    It is the tenth link, as in the thesis; of several lines, or if it does not move, the link that rotates most.
    """
    _sea_of(run)
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


@style.with_style
def tension_envelope(run: Run, path: str | Path) -> Path:
    """Minimum, mean and maximum tension along the line; of several lines a panel for each of the 12 most loaded.

    Lines of similar loads (within a factor of 4) have the same scale.
    """
    _sea_of(run)
    sizes = [np.max(run.max_tension[:, line.links]) for line in run.written_lines]
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
    unit, scale = force_unit(sizes)
    for axes, line in zip(all_axes, shown, strict=True):
        own = run.lengths[line.links]
        parts = (a[:, line.links] / scale for a in (run.tension, run.min_tension, run.max_tension))
        _envelope(axes, np.cumsum(own) - 0.5 * own, *parts)
        if len(shown) > 1:
            axes.set_title(line.name, loc="left")
    scales.share_scales(all_axes)
    figures.outer_labels(all_axes, columns, "arc length [m]", f"tension [{unit}]")
    if len(shown) == 1:
        figures.legend_above(all_axes[0], 4, "left")
    else:
        figure.legend(*all_axes[0].get_legend_handles_labels(), loc="outside lower left", ncols=4)
    return figures.finish(figure, run, what, path)


def _envelope(axes: Axes, s: np.ndarray, tension: np.ndarray, least: np.ndarray, largest: np.ndarray) -> None:
    """Tension (k, n) against the arc length (n,) of the middle of each link [m]."""
    if len(tension) > 1:
        tension = tension[1:]
        least = least[1:]
        largest = largest[1:]
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
