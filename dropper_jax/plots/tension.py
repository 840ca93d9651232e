"""Energies and tensions over time: the maximum, at the fixed points, at the ends of the lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.analysis.spectrum import balance_drift
from dropper_jax.load.scene import Scene
from dropper_jax.plots import panels, style
from dropper_jax.plots.panels import Curve, Panel, history
from dropper_jax.plots.run import TENSION, Run, changing
from dropper_jax.plots.style import force_unit
from dropper_jax.run.bends import curvature, held_points, point_load
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
    upper.plot(t, kinetic + potential - work.sum(axis=1), color=style.DARK, lw=2.4, label="sum", **mark)
    upper.plot(t, kinetic, color=style.CYCLE[0], lw=0.9, label="kinetic", **mark)
    upper.plot(t, potential, color=style.CYCLE[2], lw=0.9, label="potential, above its minimum", **mark)
    for index, name in enumerate(run.work_names):
        colour = style.CYCLE[1:2] + style.CYCLE[3:]
        upper.plot(
            t, -work[:, index], color=colour[index % len(colour)], label=f"minus work, {name.replace('_', ' ')}", **mark
        )
    upper.set_ylabel("energy [J]")
    upper.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.2)
    scale = max(np.abs(kinetic).max(), np.abs(potential).max()) or 1.0
    drift = np.maximum(np.abs(balance_drift(run)), ROUNDING * scale)
    lower.semilogy(t, drift, color=style.DARK, lw=0.8, **mark)
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
    for i, (colour, line) in enumerate(zip(style.CYCLE, lines[: 2 * MOST], strict=False)):
        mark = {"marker": "o", "ms": 2.5, "color": colour, "ls": "--" if i % 2 else "-"}  # equal lines hide each other
        arc = np.concatenate([[0.0], np.cumsum(line.spec.length)])
        upper.plot(arc[1:] - 0.5 * line.spec.length, tension[line.links] / size, label=line.name, **mark)
        lower.plot(arc, bent[line.nodes], **mark)
    upper.set_ylabel(f"tension [{unit}]")
    lower.set(xlabel="unstretched arc length [m]", ylabel="curvature [1/m]")
    upper.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2)
    return style.save(figure, path)


@style.with_style
def tension_history(run: Run, path: str | Path) -> Path:
    """Tension against time [N or kN]: the maximum of all links, the force on fixed points, both ends of lines.

    Of many the most loaded. The shade is the range of the steps of a sample if not every step is saved. A long record
    is drawn as its envelope, with a zoom around its maximum tension.
    """
    kept = slice(_begin(run), None)
    unit, size = force_unit(run.max_tension[kept])
    least = TENSION * float(np.nanmax(np.abs(run.tension[kept]), initial=0.0))
    if len(run.t) > 1 and not changing([run.min_tension[kept], run.max_tension[kept]], least).any():
        return panels.traces(
            run, path, "tension", run.t_tension, [(f"tension [{unit}]", run.tension[kept] / size)], least
        )
    found = [_largest(run, unit, size)]
    if len(run.written_lines) > 1:
        found.append(_held_points_panel(run, unit, size))
    return history(run, path, "tension", [*found, ends_panel(run)])


#: Fraction of the maximum force below which a fixed point has no curve: anchors on which the line lies.
UNLOADED = 0.01


def _begin(run: Run) -> int:
    """First sample to draw: the tension at the start belongs to no step."""
    if len(run.t) > 2:
        return 1
    return 0


def _largest(run: Run, unit: str, size: float) -> Panel:
    kept = slice(_begin(run), None)
    largest = run.max_tension[kept]
    link = int(np.unravel_index(np.argmax(np.nan_to_num(largest, nan=-np.inf)), largest.shape)[1])
    curve = Curve("", run.t_tension[kept], largest.max(axis=1) / size, colour=style.DARK)
    return Panel(f"tension [{unit}]", [curve], f"maximum over all links; the highest is in {run.labels[link]}")


def _held_points_panel(run: Run, unit: str, size: float) -> Panel:
    kept = slice(_begin(run), None)
    t = run.t_tension[kept]
    tension = run.tension[kept]
    loads = {}
    for name in held_points(run.scene):
        loads[name] = np.linalg.norm(point_load(run.scene, name, run.t, run.positions, t, tension), axis=1)
    low = {}
    high = {}
    if run.point_load_min is not None and run.point_load_max is not None:
        low = dict(zip(loads, run.point_load_min[kept, :, 2].T, strict=True))
        high = dict(zip(loads, run.point_load_max[kept, :, 2].T, strict=True))
    tops = {}
    for name, load in loads.items():
        tops[name] = float(np.nanmax(high.get(name, load)))
    least = UNLOADED * max(tops.values())
    names = [name for name in sorted(tops, key=lambda name: -tops[name]) if tops[name] > least][:MOST]
    curves = []
    for name in names:
        range_ = ()
        if name in low:
            range_ = (low[name] / size, high[name] / size)
        curves.append(Curve(name, t, loads[name] / size, *range_))
    title = _count_title("force on each fixed point", len(names), len(loads))
    unloaded = sum(top <= least for top in tops.values())
    if unloaded:
        more = f"; {unloaded} below {UNLOADED:.0%} of the maximum"
    else:
        more = ""
    return Panel(f"force [{unit}]", curves or [Curve("", t, np.zeros(len(t)))], title + more)


def ends_panel(run: Run) -> Panel:
    """Both ends of one line; of several the more loaded end."""
    kept = slice(_begin(run), None)
    unit, size = force_unit(run.max_tension[kept])
    t = run.t_tension[kept]
    lines = sorted(run.written_lines, key=lambda line: -np.nanmax(run.max_tension[kept, line.links]))[:MOST]
    both = len(lines) == 1
    curves = []
    for line in lines:
        ends = (("first link", line.links.start), ("last link", line.links.stop - 1))
        if not both:
            ends = (max(ends, key=lambda end: np.nanmax(run.max_tension[kept, end[1]])),)
        if both:
            stops = [line.stops[key] for key in (min(line.stops), max(line.stops))]
            ends = tuple((f"at {stop}", link) for stop, (_, link) in zip(stops, ends, strict=True))
        for name, link in ends:
            values = run.tension[kept, link] / size
            low = run.min_tension[kept, link] / size
            high = run.max_tension[kept, link] / size
            range_ = ()
            if run.max_tension is not run.tension:
                range_ = (low, high)
            curves.append(Curve(name if both else line.name, t, values, *range_))
    title = _count_title(
        "ends of the line" if both else "more loaded end of each line", len(lines), len(run.written_lines)
    )
    return Panel(f"tension [{unit}]", curves, title, zero=True)


def _count_title(what: str, shown: int, total: int) -> str:
    if shown == total:
        return what
    return f"{what}; {shown} of {total}"
