"""Long files as the rows that the motion needs: means over short stretches of time, without their curvature; of
uneven rows one for each stretch.

The mean over a stretch of variance s^2 in time is off by s^2/2 times the acceleration; second differences of the means
take it off.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

#: Rows per period of the fastest link that a fit needs, and from which a file is thinned.
PER_PERIOD = 40
THINNED_FROM = 80
#: Spread of the steps of time, over their median, below which rows are even.
EVEN = 0.01
#: Fraction of the rows of a stretch that its mean needs.
MEASURED = 0.5
#: Distance of means, in stretches, up to which their second differences take the curvature off.
NEAR = 3
#: Spread of the number of rows per stretch above which one row stands for each instead of the mean.
UNEVEN = 0.3


def thin(t: np.ndarray, theta: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Times (k,), angles (k, n) of about `PER_PERIOD` rows per period, and of how many rows each is the mean.

    The first and the last mean, whose curvature is not known, are left out.
    """
    interval = float(np.median(np.diff(t)))
    rows = (t[-1] - t[0]) / len(t)
    if period / rows < THINNED_FROM and period / interval < THINNED_FROM:
        return t, theta, 1
    steady = np.ptp(np.diff(t)) < EVEN * interval
    if steady:
        many = max(1, int(period / PER_PERIOD / interval))
        count = len(t) // many
        edges = np.arange(count + 1) * many
    else:
        stretch = period / PER_PERIOD
        edges = np.unique(np.searchsorted(t, np.arange(t[0], t[-1], stretch)))
        many = max(1, round(len(t) / max(len(edges) - 1, 1)))
        number = np.diff(edges)
        if np.std(number) > UNEVEN * np.mean(number):
            # a log of an encoder's steps has few rows where the motion turns: no mean there lies on the motion
            middle = (edges[:-1] + edges[1:]) // 2
            return t[middle], theta[middle], 1
    parts = list(pairwise(edges))
    times = np.array([t[a:b].mean() for a, b in parts])
    spread = np.array([t[a:b].var() for a, b in parts])
    enough = np.array([np.isfinite(theta[a:b]).mean(axis=0) > MEASURED for a, b in parts])
    sums = np.array([np.nansum(theta[a:b], axis=0) for a, b in parts])
    number = np.array([np.isfinite(theta[a:b]).sum(axis=0) for a, b in parts])
    means = np.where(enough, sums / np.maximum(number, 1), np.nan)
    before = np.diff(times)[:-1, None]
    after = np.diff(times)[1:, None]
    slope = np.diff(means, axis=0) / np.diff(times)[:, None]
    bend = 2 * np.diff(slope, axis=0) / (before + after)
    far = NEAR * period / PER_PERIOD
    near = (before < far) & (after < far) & np.isfinite(bend)
    means[1:-1] -= np.where(near, 0.5 * spread[1:-1, None] * bend, 0.0)
    return times[1:-1], means[1:-1], many
