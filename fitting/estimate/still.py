"""Stretches of a trace in which the line hangs still, found from its samples alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fitting.estimate.rest import FEWEST
from fitting.traces import planar
from fitting.traces.trace import Trace

#: Shortest stretch [s], and in slowest periods: a motion is slow at its turning points, and slower as it decays.
SHORTEST = 0.5
FIRST_PERIODS = 0.5
LAST_PERIODS = 2.0
#: Frames of a running mean; limits of a still motion: standard deviations of the mean, and a minimum angle [rad].
WIDTH = 5
STILL = 5.0
SMALLEST_MOVE = 0.002


def still_spans(trace: Trace, sigma: np.ndarray, slowest: float) -> list[tuple[float, float]]:
    """(from, to) [s] of the trace's first and last stretch at rest; frames without a sample at its ends do not count.

    The first lasts at least half of the slowest period [s], the last at least two periods. A link is still as long as
    the mean of five neighbouring frames stays within five of its standard deviations, at least 2 mrad, of its value at
    that end of the trace. `sigma` (n,) [rad] is the noise of a frame.
    """
    found: list[tuple[float, float]] = []
    known = np.flatnonzero(np.isfinite(trace.theta).any(axis=1))
    if not len(known):
        return found
    whole = slice(known[0], known[-1] + 1)
    for way, periods in ((1, FIRST_PERIODS), (-1, LAST_PERIODS)):
        times = trace.t[whole][::way]
        count = still_frames(times, trace.theta[whole][::way], sigma)
        if count >= max(FEWEST, 2 * WIDTH) and abs(times[count - 1] - times[0]) >= max(SHORTEST, periods * slowest):
            low, high = sorted((float(times[0]), float(times[count - 1])))
            found.append((low, high))
    return list(dict.fromkeys(found))


def still_frames(t: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> int:
    """Number of still frames at the start of (k, n), up to the first pause of `SHORTEST` without samples."""
    least = len(theta)
    for column, size in zip(theta.T, sigma, strict=True):
        known = np.flatnonzero(np.isfinite(column))
        pause = np.abs(np.diff(t[known], prepend=t[0])) > SHORTEST
        known = known[: int(np.argmax(pause)) if pause.any() else None]
        if len(known) < 2 * WIDTH:
            return 0
        mean = np.convolve(column[known], np.full(WIDTH, 1 / WIDTH), "valid")
        # relative to the mean of all still frames so far: the first few alone are too noisy
        before = np.cumsum(mean) / np.arange(1, len(mean) + 1)
        moves = np.flatnonzero(np.abs(mean[1:] - before[:-1]) > max(STILL * size / np.sqrt(WIDTH), SMALLEST_MOVE))
        least = min(least, int(known[moves[0] + 1] if len(moves) else known[-1] + 1))
    return least


#: Angle [rad] between a still pose and equilibrium above which something else must hold the line: errors of 1 % in
#: lengths and ends move the pose of a line between fixed ends by less.
HELD_ANGLE = 0.1


def held_start(trace: Trace, sigma: np.ndarray, slowest: float, pose: Callable[[], np.ndarray]) -> float | None:
    """Time [s] from which the line moves, if something other than its own ends holds it still before.

    `pose()` (n,) [rad] is the equilibrium. The frames of the running mean that contain the motion are omitted: the line
    may be released in any of them.
    """
    spans = still_spans(trace, sigma, slowest)
    known = np.flatnonzero(np.isfinite(trace.theta).any(axis=1))
    if not spans or spans[0][0] > trace.t[known[0]]:
        return None
    still = trace.between(spans[0][0], spans[0][1] + 1e-6)
    off = planar.wrap(np.nanmedian(still.theta, axis=0) - pose())

    later = known[trace.t[known] > spans[0][1]][WIDTH:]
    if len(later) and np.abs(off).max() > HELD_ANGLE:
        return float(trace.t[later[0]])
    return None


def advice_on_rest(trace: Trace, sigma: np.ndarray, slowest: float) -> list[str]:
    """A line for each stretch at rest that a fit could use as a pose but does not."""
    found = []
    for low, high in still_spans(trace, sigma, slowest):
        found.append(
            f"{trace.name} is at rest from {low:.3g} to {high:.3g} s. "
            f"Use --rest {np.ceil(100 * low) / 100:g}:{np.floor(100 * high) / 100:g} to fit that pose as well: it "
            "determines the rig's numbers, if only the scene's own hooks hold the line then"
        )
    return found
