"""Energies and tensions over time: the maximum, at the fixed points, at the ends of the lines."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropper_jax.analysis.spectrum import balance_drift
from dropper_jax.load.scene import Scene
from dropper_jax.plots import panels, style
from dropper_jax.plots.run import TENSION, Run, changing
from dropper_jax.plots.style import CYCLE, DARK, force_unit
from dropper_jax.plots.time_panels import Curve, Panel, history
from dropper_jax.run.bends import curvature
from dropper_jax.run.end_links import Motion, loaded_fixed_points, point_loads
from dropper_jax.scene import whole_lines

#: Drift below this fraction of the maximum energy is rounding: the log axis ends there.
ROUNDING = 1e-17


@style.with_style
def energy_balance(run: Run, path: str | Path) -> Path:
    """Kinetic and potential energy (above its minimum), minus the work of each contribution, their sum, its drift [J].

    The sum is constant for an exact solution; below it, the absolute drift on a logarithmic axis.
    """
    t = run.t
    kinetic = run.kinetic
    work = run.work
    potential = run.potential - run.potential.min()
    figure = style.new_figure(8.5, 5.8)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1))
    mark = {"marker": style.marker(t), "ms": 4}
    # The sum is drawn below the others: if there is only one energy, both stay visible.
    upper.plot(t, kinetic + potential - work.sum(axis=1), color=DARK, lw=2.4, label="sum", **mark)
    upper.plot(t, kinetic, color=CYCLE[0], lw=0.9, label="kinetic", **mark)
    upper.plot(t, potential, color=CYCLE[2], lw=0.9, label="potential, above its minimum", **mark)
    colours = itertools.cycle(CYCLE[1:2] + CYCLE[3:])
    for name, done, colour in zip(run.work_names, work.T, colours, strict=False):
        upper.plot(t, -done, color=colour, label=f"minus work, {name.replace('_', ' ')}", **mark)
    upper.set_ylabel("energy [J]")
    style.legend_above(upper, 3, "left", borderaxespad=0.2)
    scale = max(np.abs(kinetic).max(), np.abs(potential).max()) or 1.0
    drift = np.maximum(np.abs(balance_drift(run)), ROUNDING * scale)
    lower.semilogy(t, drift, color=DARK, lw=0.8, **mark)
    lower.set_ylim(0.5 * drift[1:].min(initial=drift.max()), 3 * drift.max())
    lower.set_ylabel("|drift| [J]")
    style.time_axis(lower, t)
    return style.finish(figure, run, "energy balance", path)


#: Maximum number of curves in one panel.
MOST = 4


@style.plot_style()
def along_lines(scene: Scene, positions: np.ndarray, tension: np.ndarray, path: str | Path) -> Path:
    """Tension [N or kN] and curvature [1/m] of a static pose over the arc length, of the lines with the most tension.

    Args:
        positions: all nodes (nodes, 3) [m]; tension: (n,) [N].
    """
    bent = curvature(scene, positions[None])[0]
    bent[bent == 0.0] = np.nan  # ends, and points that cut a line
    lines = sorted(whole_lines(scene), key=lambda line: -tension[line.links].max())
    unit, size = force_unit(tension)
    figure = style.new_figure(7.5, 4.8)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for i, (colour, line) in enumerate(zip(CYCLE, lines[: 2 * MOST], strict=False)):
        dashes = "--" if i % 2 else "-"  # equal lines hide each other
        mark = {"marker": "o", "ms": 2.5, "color": colour, "ls": dashes}
        arc = np.concatenate([[0.0], np.cumsum(line.spec.length)])
        upper.plot(arc[1:] - 0.5 * line.spec.length, tension[line.links] / size, label=line.name, **mark)
        lower.plot(arc, bent[line.nodes], **mark)
    upper.set_ylabel(f"tension [{unit}]")
    lower.set(xlabel="unstretched arc length [m]", ylabel="curvature [1/m]")
    style.legend_above(upper, 4, "left", borderaxespad=0.2)
    return style.save(figure, path)


class Loads(NamedTuple):
    """Tensions of a picture without the start, which belongs to no step.

    Attributes:
        t: times (k,) [s].
        tension, low, high: tensions (k, n) and the range of the steps of each sample, in `unit`.
        unit: name of the unit, and its `size` [N].
        samples: the samples.
    """

    t: np.ndarray
    tension: np.ndarray
    low: np.ndarray
    high: np.ndarray
    unit: str
    size: float
    samples: slice


def loads_of(run: Run) -> Loads:
    """The tensions of a run in one unit."""
    samples = slice(int(len(run.t) > 2), None)
    unit, size = force_unit(run.max_tension[samples])
    tensions = (run.tension[samples] / size, run.min_tension[samples] / size, run.max_tension[samples] / size)
    return Loads(run.t_tension[samples], *tensions, unit, size, samples)


@style.with_style
def tension_history(run: Run, path: str | Path) -> Path:
    """Tension against time [N or kN]: the maximum of all links, the force on fixed points, both ends of lines.

    Of many the most loaded. The shade is the range of the steps of a sample if not every step is saved. A long record
    is drawn as its envelope, with a zoom around its maximum tension.
    """
    loads = loads_of(run)
    least = TENSION * np.nanmax(np.abs(loads.tension), initial=0.0)
    if len(run.t) > 1 and not changing([loads.low, loads.high], least).any():
        return panels.constants(run, path, "tension", [(f"tension [{loads.unit}]", loads.tension)])
    found = [_largest(run, loads)]
    if len(run.written_lines) > 1:
        found.append(held_points_panel(run, loads))
    return history(run, path, "tension", [*found, ends_panel(run, loads)])


#: Fraction of the maximum force below which a fixed point has no curve: anchors on which the line lies.
UNLOADED = 0.01


def _largest(run: Run, loads: Loads) -> Panel:
    """The maximum over all links."""
    link = int(np.argmax(np.nan_to_num(loads.high, nan=-np.inf).max(axis=0)))
    curve = Curve("", loads.t, loads.high.max(axis=1), colour=DARK)
    return Panel(f"tension [{loads.unit}]", [curve], f"maximum over all links; the highest is in {run.labels[link]}")


def held_points_panel(run: Run, loads: Loads) -> Panel:
    """Forces on the most loaded fixed points."""
    names = loaded_fixed_points(run.scene)
    vectors = point_loads(Motion(run.scene, run.t, run.positions, loads.t, run.tension[loads.samples]))
    forces = [vectors[name] for name in names]
    force = np.linalg.norm(forces, axis=-1).T / loads.size
    low = force
    high = force
    if run.point_load_min is not None and run.point_load_max is not None:
        low = run.point_load_min[loads.samples, :, 2] / loads.size
        high = run.point_load_max[loads.samples, :, 2] / loads.size
    tops = np.nanmax(high, axis=0)
    loaded = tops > UNLOADED * tops.max()
    shown = [i for i in np.argsort(-tops, kind="stable") if loaded[i]][:MOST]
    curves = [Curve(names[i], loads.t, force[:, i], low[:, i], high[:, i]) for i in shown]
    title = _count_title("force on each fixed point", len(shown), len(names))
    unloaded = len(names) - int(loaded.sum())
    if unloaded:
        title = f"{title}; {unloaded} below {UNLOADED:.0%} of the maximum"
    return Panel(f"force [{loads.unit}]", curves or [Curve("", loads.t, np.zeros(len(loads.t)))], title)


def ends_panel(run: Run, loads: Loads) -> Panel:
    """Both ends of one line; of several the more loaded end."""
    tops = np.nanmax(loads.high, axis=0)
    lines = sorted(run.written_lines, key=lambda line: -tops[line.links].max())[:MOST]
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
        curves.append(Curve(name, loads.t, loads.tension[:, link], loads.low[:, link], loads.high[:, link]))
    title = _count_title(what, len(lines), len(run.written_lines))
    return Panel(f"tension [{loads.unit}]", curves, title, zero=True)


def _count_title(what: str, shown: int, total: int) -> str:
    """A title with the numbers of curves if some are not shown."""
    if shown == total:
        return what
    return f"{what}; {shown} of {total}"
