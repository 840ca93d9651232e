"""Stretches of a trace in which the line hangs still, found by its samples alone."""

from __future__ import annotations

import numpy as np

from fitting.estimate.rest import FEWEST
from fitting.traces.trace import Trace

#: Shortest stretch [s]; at the end, where a motion dies away, in slowest periods.
SHORTEST, PERIODS = 0.5, 2.0
#: Frames of a running mean; deviations of it, and the least angle [rad], that are still.
WIDTH, STILL, LEAST = 5, 5.0, 0.002


def still_spans(trace: Trace, sigma: np.ndarray, slowest: float) -> list[tuple[float, float]]:
    """(from, to) [s] of the trace's first and last stretch at rest.

    The first lasts half a second at least, the last two of the slowest periods [s]: a motion that dies away is slow at
    its turns. A link is still as long as the mean of five neighbouring frames stays within five of its deviations, at
    least 2 mrad, of where it was at that end of the trace. `sigma` (n,) [rad] is the noise of a frame.
    """
    found = []
    for way, shortest in ((1, SHORTEST), (-1, max(SHORTEST, PERIODS * slowest))):
        t, theta = trace.t[::way], trace.theta[::way]
        count = still_frames(theta, sigma)
        if count >= max(FEWEST, 2 * WIDTH) and abs(t[count - 1] - t[0]) >= shortest:
            found.append(tuple(sorted((float(t[0]), float(t[count - 1])))))
    return list(dict.fromkeys(found))


def still_frames(theta: np.ndarray, sigma: np.ndarray) -> int:
    """How many of the first frames (k, n) are still."""
    least = len(theta)
    for column, size in zip(theta.T, sigma, strict=True):
        known = np.flatnonzero(np.isfinite(column))
        if len(known) < 2 * WIDTH:
            return 0
        mean = np.convolve(column[known], np.full(WIDTH, 1 / WIDTH), "valid")
        # against the mean of all that was still so far: noise of the first few is no measure
        before = np.cumsum(mean) / np.arange(1, len(mean) + 1)
        moves = np.flatnonzero(np.abs(mean[1:] - before[:-1]) > max(STILL * size / np.sqrt(WIDTH), LEAST))
        if len(moves):
            least = min(least, int(known[moves[0] + 1]))
    return least


def advice_on_rest(trace: Trace, sigma: np.ndarray, slowest: float) -> list[str]:
    """A line for each stretch at rest that a fit could take as a pose, and does not."""
    found = []
    for low, high in still_spans(trace, sigma, slowest):
        span = f"{np.ceil(100 * low) / 100:g}:{np.floor(100 * high) / 100:g}"
        found.append(
            f"{trace.name} rests from {low:.3g} to {high:.3g} s: --rest {span} would fit that pose as well, which "
            "tells the rig's numbers, if nothing but the scene's own hooks holds the line then"
        )
    return found
