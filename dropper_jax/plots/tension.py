"""Tensions over time: the maximum of all links, forces on fixed points, ends of lines."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropper_jax.plots import panels, style
from dropper_jax.plots.movement import changing
from dropper_jax.plots.run import TENSION_ROUNDING, Run
from dropper_jax.plots.scales import force_unit
from dropper_jax.plots.style import DARK
from dropper_jax.plots.time_panels import Curve, Panel, history
from dropper_jax.quantities.end_links import loaded_fixed_points
from dropper_jax.quantities.step_extremes import LOADS

#: The total load of a fixed point among the components of its load.
TOTAL = LOADS.index("total")
#: Maximum number of curves in one panel.
MAX_CURVES = 4


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

    def curve(self, name: str, link: int) -> Curve:
        """The tension of a link, with its range."""
        return Curve(name, self.t, self.tension[:, link], self.low[:, link], self.high[:, link])


def scale_tensions(run: Run) -> ScaledTensions:
    """The tensions of a run in one unit."""
    samples = slice(0, None)
    if len(run.t) > 2:
        samples = slice(1, None)
    unit, size = force_unit(run.max_tension[samples])
    scaled = [tension[samples] / size for tension in (run.tension, *run.tension_range)]
    return ScaledTensions(run.t_tension[samples], *scaled, unit, size, samples)


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
    if len(run.written_lines) > 1 and loaded_fixed_points(run.scene):  # lines of a drifting body have none
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
    loads = run.signal("point_load")
    least, largest, *_ = run.step_extremes("point_load", loads)
    force, low, high = (rows[scaled.samples, :, TOTAL] / scaled.size for rows in (loads, least, largest))
    tops = np.nanmax(high, axis=0)
    loaded = tops > UNLOADED_SHARE * np.max(tops, initial=0.0)
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
    ends = [(line.name, max(line.links.start, line.links.stop - 1, key=lambda link: tops[link])) for line in lines]
    if len(lines) == 1:
        what = "ends of the line"
        line = lines[0]
        start, *_, end = line.stops.values()  # the same point of a loop
        ends = [(f"at {start}", line.links.start), (f"at {end}", line.links.stop - 1)]
    curves = [scaled.curve(name, link) for name, link in ends]
    title = _count_title(what, len(lines), len(run.written_lines))
    return Panel(f"tension [{scaled.unit}]", curves, title, zero=True)


def _count_title(what: str, shown: int, total: int) -> str:
    """A title with the numbers of curves if some are not shown."""
    if shown == total:
        return what
    return f"{what}; {shown} of {total}"
