"""Tension over time: its maximum, at the fixed points, at the ends of the lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.plots import moving, panels, style
from dropper_jax.plots.run import Run
from dropper_jax.plots.series import Curve, Panel, history
from dropper_jax.plots.units import force_unit
from dropper_jax.run.bends import held_points, point_load

#: Maximum number of curves in one panel.
MOST = 4


@style.with_style
def tension_history(run: Run, path: str | Path) -> Path:
    """Tension against time [N or kN]: the maximum of all links, the force on fixed points, both ends of lines.

    Of many the most loaded. The shade is the range within a sample if steps adapt to snap loads. A long record is drawn
    as its envelope, with a zoom around its maximum tension.
    """
    kept = slice(_begin(run), None)
    unit, size = force_unit(run.max_tension[kept])
    least = moving.TENSION * float(np.nanmax(np.abs(run.tension[kept]), initial=0.0))
    if len(run.t) > 1 and not moving.changing([run.min_tension[kept], run.max_tension[kept]], least).any():
        return panels.traces(
            run, path, "tension", run.t_tension, [(f"tension [{unit}]", run.tension[kept] / size)], least
        )
    found = [_largest(run, unit, size)]
    if run.scene is not None and len(run.written_lines) > 1:
        found.append(_held_points_panel(run, unit, size))
    return history(run, path, "tension", [*found, ends_panel(run)])


def _begin(run: Run) -> int:
    """First sample to draw: the tension at the start belongs to no step."""
    return 1 if len(run.t) > 2 else 0


def _largest(run: Run, unit: str, size: float) -> Panel:
    kept = slice(_begin(run), None)
    largest = run.max_tension[kept]
    link = int(np.unravel_index(np.argmax(np.nan_to_num(largest, nan=-np.inf)), largest.shape)[1])
    curve = Curve("", run.t_tension[kept], largest.max(axis=1) / size, colour=style.DARK)
    return Panel(f"tension [{unit}]", [curve], f"maximum over all links; the highest is in {run.labels[link]}")


def _held_points_panel(run: Run, unit: str, size: float) -> Panel:
    kept = slice(_begin(run), None)
    t, tension = run.t_tension[kept], run.tension[kept]
    loads = {
        name: np.linalg.norm(point_load(run.scene, name, run.t, run.positions, t, tension), axis=1)
        for name in held_points(run.scene)
    }
    names = sorted(loads, key=lambda name: -np.nanmax(loads[name]))[:MOST]
    curves = [Curve(name, t, loads[name] / size) for name in names]
    return Panel(f"force [{unit}]", curves, _count_title("force on each fixed point", len(names), len(loads)))


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
        if both and run.scene is not None:
            stops = [line.stops[key] for key in (min(line.stops), max(line.stops))]
            ends = tuple((f"at {stop}", link) for stop, (_, link) in zip(stops, ends, strict=True))
        for name, link in ends:
            values, low, high = (a[kept, link] / size for a in (run.tension, run.min_tension, run.max_tension))
            range_ = (None, None) if run.extremes is None else (low, high)
            curves.append(Curve(name if both else line.name, t, values, *range_))
    title = (
        "ends of the line" if both else _count_title("more loaded end of each line", len(lines), len(run.written_lines))
    )
    return Panel(f"tension [{unit}]", curves, title, zero=True)


def _count_title(what: str, shown: int, total: int) -> str:
    return what if shown == total else f"{what}; {shown} of {total}"
