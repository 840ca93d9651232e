"""Loads of the lines of a run: mean, deviation and extremes of tension, each with its standard error by chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dropper_jax.base.interpolation import interpolate_rows
from dropper_jax.evaluation.record import Record, arc
from dropper_jax.evaluation.settings import Settings
from dropper_jax.evaluation.snaps import line_snaps
from dropper_jax.load.periods import periods
from dropper_jax.run.samples import Samples, is_finished
from dropper_jax.sea.make import main_period

#: Loads of each line: mean and standard deviation in time of the link with the maximum tension [N], mean of the maxima
#: in windows of a wave [N], maximum and minimum [N], number of snaps.
QUANTITIES = ("mean", "deviation", "window_maximum", "maximum", "minimum", "snaps")
#: Number of saved times below which a run has no statistics.
MIN_TIMES = 4
#: Number of parts of a record whose means give the standard error of the whole.
BATCHES = 8
#: Window of a maximum in calm water [s]; in waves their period.
CALM_WINDOW = 10.0


class Load(NamedTuple):
    """A load of a line.

    Attributes:
        value: [N]; a number of snaps has no unit.
        chance: its standard error by chance, in the same unit; NaN if the record is too short for one.
    """

    value: float
    chance: float


@dataclass(frozen=True)
class LineLoads:
    """Loads of a line, all at one position along it.

    Attributes:
        line: its name.
        at_m: arc length of the position [m].
        loads: by their names, which are `QUANTITIES`.
    """

    line: str
    at_m: float
    loads: dict[str, Load]

    @property
    def values(self) -> dict[str, float]:
        """The loads without their standard errors."""
        return {name: load.value for name, load in self.loads.items()}


def has_loads(solution: Samples) -> bool:
    """Whether a run has loads to compare."""
    return len(solution.t) >= MIN_TIMES and is_finished(solution)


def line_loads(found: Record, like: Sequence[LineLoads] | None = None) -> list[LineLoads]:
    """Loads of every line: of its link with the maximum tension, or where those of another run, `like`, are."""
    snaps = line_snaps(found, Settings())
    within = found.square - found.tension**2
    rows = []
    for i, where in enumerate(found.written_lines):
        s = arc(where.spec.length)
        extremes = found.extremes["tension"].of(where.links)
        if like is None:
            at = s[int(np.argmax(extremes.largest.max(axis=0)))]
        else:
            at = like[i].at_m
        arrays = (found.tension[:, where.links], extremes.least, extremes.largest, within[:, where.links])
        at_link = [interpolate_rows(s, values.T, np.array([at]))[0] for values in arrays]
        loads = _statistics(found, *at_link)
        loads["snaps"] = Load(snaps[i]["most_events"], 0.0)
        rows.append(LineLoads(where.name, at, loads))
    return rows


def _statistics(
    found: Record, tension: np.ndarray, lowest: np.ndarray, largest: np.ndarray, within: np.ndarray
) -> dict[str, Load]:
    """Loads at one position of a line without its snaps.

    Args:
        tension: means of the samples (q,) [N].
        lowest, largest: extremes of all steps in a sample (q,) [N].
        within: variance in a sample (q,) [N^2].
    """
    square = tension**2 + within
    tops = _window_maxima(found, largest)
    bottoms = _window_maxima(found, -lowest)
    batches = [part for part in np.array_split(np.arange(len(tension)), BATCHES) if part.size]
    means = np.array([tension[part].mean() for part in batches])
    deviations = np.array([_deviation(tension[part], square[part]) for part in batches])
    return {
        "mean": Load(tension.mean(), _standard_error(means)),
        "deviation": Load(_deviation(tension, square), _standard_error(deviations)),
        "window_maximum": Load(tops.mean(), _standard_error(tops)),
        # maximum of many: the same spread as one window maximum (a Gumbel distribution keeps its scale)
        "maximum": Load(tops.max(), _sample_deviation(tops)),
        "minimum": Load(-bottoms.max(), _sample_deviation(bottoms)),
    }


def _deviation(values: np.ndarray, squares: np.ndarray) -> float:
    """Standard deviation of values with these squares."""
    return np.sqrt(max(squares.mean() - values.mean() ** 2, 0.0))


def _sample_deviation(values: np.ndarray) -> float:
    """Standard deviation of a sample; NaN of one value."""
    if len(values) < 2:
        return float("nan")
    return values.std(ddof=1)


def _standard_error(values: np.ndarray) -> float:
    """Standard error of the mean of a sample; NaN of one value."""
    return _sample_deviation(values) / np.sqrt(len(values))


def _window_maxima(found: Record, values: np.ndarray) -> np.ndarray:
    """Maxima in windows of a peak period, or of `CALM_WINDOW`; the full record if it is shorter."""
    sea = found.scene.sea
    period = CALM_WINDOW
    if sea is not None and sea.waves is not None:
        period = periods(found.scene).get("waves") or main_period(sea, sea.waves)
    count = max(int(found.duration / period), 1)
    edges = np.linspace(found.t_tension[0], found.t_tension[-1] + found.interval, count + 1)
    window = np.clip(np.digitize(found.t_tension, edges) - 1, 0, count - 1)
    return np.array([values[window == i].max() for i in range(count) if np.any(window == i)])
