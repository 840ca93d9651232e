"""Long files as the rows that the motion needs: means over short stretches of time, without their curvature; of
uneven rows one for each stretch.

The mean over a stretch of variance s^2 in time is off by s^2/2 times the acceleration; second differences of the means
take it off.
"""

from __future__ import annotations

import numpy as np

from fitting.from_file.clock import mean_rows

#: Rows per period of the fastest link that a fit needs, and from which a file is thinned.
ROWS_PER_PERIOD = 40
THINNED_ROWS_PER_PERIOD = 80
#: Spread of the steps of time, over their median, below which rows are even.
EVEN_SPREAD = 0.01
#: Fraction of the rows of a stretch that its mean needs.
MEASURED_FRACTION = 0.5
#: Distance of means, in stretches, up to which their second differences take the curvature off.
NEAR_STRETCHES = 3
#: Spread of the number of rows per stretch above which one row stands for each instead of the mean.
UNEVEN_SPREAD = 0.3


def thin(t: np.ndarray, theta: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Times (k,), angles (k, n) of about `ROWS_PER_PERIOD` rows per period, and of how many rows each is the mean.

    The first and the last mean, whose curvature is not known, are left out.
    """
    interval = float(np.median(np.diff(t)))
    mean_interval = (t[-1] - t[0]) / len(t)
    if period / mean_interval < THINNED_ROWS_PER_PERIOD and period / interval < THINNED_ROWS_PER_PERIOD:
        return t, theta, 1
    if np.ptp(np.diff(t)) < EVEN_SPREAD * interval:
        many = max(1, int(period / ROWS_PER_PERIOD / interval))
        edges = np.arange(len(t) // many + 1) * many
    else:
        edges = np.unique(np.searchsorted(t, np.arange(t[0], t[-1], period / ROWS_PER_PERIOD)))
        many = max(1, round(len(t) / max(len(edges) - 1, 1)))
        number = np.diff(edges)
        if np.std(number) > UNEVEN_SPREAD * np.mean(number):
            # a log of an encoder's steps has few rows where the motion turns: no mean there lies on the motion
            middle = (edges[:-1] + edges[1:]) // 2
            return t[middle], theta[middle], 1
    first = edges[:-1]
    size = np.diff(edges)
    t = t[: edges[-1]]
    times, _ = mean_rows(t, first)
    spread, _ = mean_rows((t - np.repeat(times, size)) ** 2, first)
    means, number = mean_rows(theta[: edges[-1]], first)
    means[number <= MEASURED_FRACTION * size[:, None]] = np.nan
    before = np.diff(times)[:-1, None]
    after = np.diff(times)[1:, None]
    bend = 2 * np.diff(np.diff(means, axis=0) / np.diff(times)[:, None], axis=0) / (before + after)
    far = NEAR_STRETCHES * period / ROWS_PER_PERIOD
    near = (before < far) & (after < far) & np.isfinite(bend)
    means[1:-1] -= np.where(near, 0.5 * spread[1:-1, None] * bend, 0.0)
    return times[1:-1], means[1:-1], many
