"""Tensions over time and along lines."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropper_jax.load.scene import Scene
from dropper_jax.plots import figures, panels, style
from dropper_jax.plots.run import TENSION_ROUNDING, Run, changing
from dropper_jax.plots.scales import force_unit
from dropper_jax.plots.style import CYCLE, DARK
from dropper_jax.plots.time_panels import Curve, Panel, history
from dropper_jax.run.bends import curvature
from dropper_jax.run.end_links import Motion, loaded_fixed_points, point_loads
from dropper_jax.scene import whole_lines

#: Maximum number of curves in one panel.
MAX_CURVES = 4


@style.plot_style()
def along_lines(scene: Scene, positions: np.ndarray, tension: np.ndarray, path: str | Path) -> Path:
    """Tension [N or kN] and curvature [1/m] over the arc length of the lines with the most tension, at equilibrium.

    Args:
        positions: all nodes (nodes, 3) [m]; tension: (n,) [N].
    """
    bent = curvature(scene, positions[None])[0]
    bent[bent == 0.0] = np.nan  # ends, and points that cut a line
    lines = sorted(whole_lines(scene), key=lambda line: -tension[line.links].max())
    unit, size = force_unit(tension)
    figure = figures.new_figure(7.5, 4.8)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for i, (colour, line) in enumerate(zip(CYCLE, lines[: 2 * MAX_CURVES], strict=False)):
        dashes = "--" if i % 2 else "-"  # equal lines hide each other
        mark = {"marker": "o", "ms": 2.5, "color": colour, "ls": dashes}
        arc = np.concatenate([[0.0], np.cumsum(line.spec.length)])
        upper.plot(arc[1:] - 0.5 * line.spec.length, tension[line.links] / size, label=line.name, **mark)
        lower.plot(arc, bent[line.nodes], **mark)
    upper.set_ylabel(f"tension [{unit}]")
    lower.set(xlabel="unstretched arc length [m]", ylabel="curvature [1/m]")
    figures.legend_above(upper, 4, "left", borderaxespad=0.2)
    return figures.save(figure, path)


class ScaledTensions(NamedTuple):
    """Tensions of a picture without those of the start, which belongs to no step.

    Attributes:
        t: times (k,) [s].
        tension, low, high: tensions (k, n) and the range of the steps of each sample, in `unit`.
        unit: name of the unit, and its `size` [N].
        samples: slice of the run without its start.
    """

    t: np.ndarray
    tension: np.ndarray
    low: np.ndarray
    high: np.ndarray
    unit: str
    size: float
    samples: slice


def scale_tensions(run: Run) -> ScaledTensions:
    """The tensions of a run in one unit."""
    samples = slice(0, None)
    if len(run.t) > 2:
        samples = slice(1, None)
    unit, size = force_unit(run.max_tension[samples])
    tensions = (run.tension[samples] / size, run.min_tension[samples] / size, run.max_tension[samples] / size)
    return ScaledTensions(run.t_tension[samples], *tensions, unit, size, samples)


@style.with_style
def tension_history(run: Run, path: str | Path) -> Path:
    """Tension against time [N or kN]: the maximum of all links, the force on fixed points, both ends of lines.

    Of many points and lines the most loaded are drawn. The shade is the range of the steps of a sample if not every
    step is saved. A long record is drawn as its envelope, with a zoom around its maximum tension.
    """
    scaled = scale_tensions(run)
    threshold = TENSION_ROUNDING * np.nanmax(np.abs(scaled.tension), initial=0.0)
    if len(run.t) > 1 and not changing([scaled.low, scaled.high], threshold).any():
        return panels.constants(run, path, "tension", [(f"tension [{scaled.unit}]", scaled.tension)])
    shown = [maximum_panel(run, scaled)]
    if len(run.written_lines) > 1:
        shown.append(fixed_points_panel(run, scaled))
    return history(run, path, "tension", [*shown, ends_panel(run, scaled)])


#: Fraction of the maximum force below which a fixed point has no curve: anchors on which the line lies.
UNLOADED_SHARE = 0.01


def maximum_panel(run: Run, scaled: ScaledTensions) -> Panel:
    """The maximum over all links."""
    link = int(np.argmax(np.nan_to_num(scaled.high, nan=-np.inf).max(axis=0)))
    curve = Curve("", scaled.t, scaled.high.max(axis=1), colour=DARK)
    return Panel(f"tension [{scaled.unit}]", [curve], f"maximum over all links; the highest is in {run.labels[link]}")


def fixed_points_panel(run: Run, scaled: ScaledTensions) -> Panel:
    """Forces on the most loaded fixed points."""
    names = loaded_fixed_points(run.scene)
    vectors = point_loads(Motion(run.scene, run.t, run.positions, scaled.t, run.tension[scaled.samples]))
    forces = [vectors[name] for name in names]
    force = np.linalg.norm(forces, axis=-1).T / scaled.size
    low = force
    high = force
    if run.point_load_min is not None and run.point_load_max is not None:
        low = run.point_load_min[scaled.samples, :, 2] / scaled.size
        high = run.point_load_max[scaled.samples, :, 2] / scaled.size
    tops = np.nanmax(high, axis=0)
    loaded = tops > UNLOADED_SHARE * tops.max()
    shown = [i for i in np.argsort(-tops, kind="stable") if loaded[i]][:MAX_CURVES]
    curves = [Curve(names[i], scaled.t, force[:, i], low[:, i], high[:, i]) for i in shown]
    title = _count_title("force on each fixed point", len(shown), len(names))
    unloaded = len(names) - int(loaded.sum())
    if unloaded:
        title = f"{title}; {unloaded} below {UNLOADED_SHARE:.0%} of the maximum"
    return Panel(f"force [{scaled.unit}]", curves or [Curve("", scaled.t, np.zeros(len(scaled.t)))], title)


def ends_panel(run: Run, scaled: ScaledTensions) -> Panel:
    """Both ends of one line; of several the more loaded end."""
    tops = np.nanmax(scaled.high, axis=0)
    lines = sorted(run.written_lines, key=lambda line: -tops[line.links].max())[:MAX_CURVES]
    what = "more loaded end of each line"
    ends = {}
    for line in lines:
        ends[line.name] = max((line.links.start, line.links.stop - 1), key=lambda link: tops[link])
    if len(lines) == 1:
        what = "ends of the line"
        line = lines[0]
        start, *_, end = line.stops.values()
        ends = {f"at {start}": line.links.start, f"at {end}": line.links.stop - 1}
    curves = []
    for name, link in ends.items():
        curves.append(Curve(name, scaled.t, scaled.tension[:, link], scaled.low[:, link], scaled.high[:, link]))
    title = _count_title(what, len(lines), len(run.written_lines))
    return Panel(f"tension [{scaled.unit}]", curves, title, zero=True)


def _count_title(what: str, shown: int, total: int) -> str:
    """A title with the numbers of curves if some are not shown."""
    if shown == total:
        return what
    return f"{what}; {shown} of {total}"
