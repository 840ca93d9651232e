"""Long files as the rows that the motion needs: means over short stretches of time, without their curvature; of
uneven rows one for each stretch.

The mean over a stretch of variance s^2 in time is off by s^2/2 times the acceleration; second differences of the means
take it off.
"""

from __future__ import annotations

import numpy as np

from fitting.from_file.clock import mean_rows
from fitting.traces.trace import FEWEST_SAMPLES

#: Rows per period of the fastest link that a fit needs.
ROWS_PER_PERIOD = 40
#: Rows per period from which a file is thinned: a mean has two of them at least.
THINNED_ROWS_PER_PERIOD = 2 * ROWS_PER_PERIOD
#: Spread of the steps of time, over their median, below which rows are even.
EVEN_SPREAD = 0.01
#: Fraction of the rows of a stretch that its mean needs: of fewer, the time of the mean is not that of all rows.
MEASURED_FRACTION = 0.5
#: Distance of means, in stretches, up to which their second differences take the curvature off: across a longer gap
#: they are not the acceleration.
NEAR_STRETCHES = 3
#: Spread of the number of rows per stretch, over its mean, above which one row stands for each instead of the mean: a
#: log of an encoder's steps has few rows where the motion turns, and no mean there lies on the motion.
UNEVEN_SPREAD = 0.3


def thin_rows(t: np.ndarray, theta: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Times (k,), angles (k, n) of about `ROWS_PER_PERIOD` rows per period, and of how many rows each is the mean.

    The first and the last mean, whose curvature is not known, are left out. All rows are returned if there are few of
    them per period, or if fewer than `FEWEST_SAMPLES` means would remain.
    """
    interval = float(np.median(np.diff(t)))
    mean_interval = (t[-1] - t[0]) / (len(t) - 1)
    if period / mean_interval < THINNED_ROWS_PER_PERIOD and period / interval < THINNED_ROWS_PER_PERIOD:
        return t, theta, 1
    edges = _edges_of_stretches(t, period / ROWS_PER_PERIOD)
    size = np.diff(edges)
    if len(size) - 2 < FEWEST_SAMPLES:
        return t, theta, 1
    if np.std(size) > UNEVEN_SPREAD * np.mean(size):
        middle = (edges[:-1] + edges[1:]) // 2
        return t[middle], theta[middle], 1
    times, means = _means(t, theta, edges, NEAR_STRETCHES * period / ROWS_PER_PERIOD)
    return times, means, round(float(np.mean(size)))


def _edges_of_stretches(t: np.ndarray, stretch: float) -> np.ndarray:
    """First row of each stretch of time [s], and the row after the last one: equal numbers of rows if rows are even."""
    steps = np.diff(t)
    interval = float(np.median(steps))
    if np.ptp(steps) < EVEN_SPREAD * interval:
        many = max(1, int(stretch / interval))
        return np.arange(len(t) // many + 1) * many
    return np.unique(np.searchsorted(t, np.arange(t[0], t[-1], stretch)))


def _means(t: np.ndarray, theta: np.ndarray, edges: np.ndarray, far: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean times (k,) and angles (k, n) of all stretches but the first and the last, without their curvature.

    Args:
        far: distance of means [s] from which their second differences are not the acceleration.
    """
    first = edges[:-1]
    size = np.diff(edges)
    t = t[: edges[-1]]
    times, _ = mean_rows(t, first)
    variance, _ = mean_rows((t - np.repeat(times, size)) ** 2, first)
    means, number = mean_rows(theta[: edges[-1]], first)
    means[number <= MEASURED_FRACTION * size[:, None]] = np.nan
    steps = np.diff(times)[:, None]
    before = steps[:-1]
    after = steps[1:]
    acceleration = 2 * np.diff(np.diff(means, axis=0) / steps, axis=0) / (before + after)
    near = (before < far) & (after < far) & np.isfinite(acceleration)
    means[1:-1] -= np.where(near, 0.5 * variance[1:-1, None] * acceleration, 0.0)
    return times[1:-1], means[1:-1]
