"""Frames that are missing without being marked.

They make the traces jump along the flow: a fitted window, continued through the next one, meets its samples again that
many frames later. The frame f and the number of lost frames k are those that maximise

    sum_{i >= f} rho(r_i) - rho(r_i,k),      r_i,k = (theta(t_i + k dt) - measured_i)/sigma

by which the samples after f fit better (rho is bounded, so that no single sample decides).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fitting.estimate.solution import Solution
from fitting.estimate.windows import Starts, Windows, fill, pick, with_rows
from fitting.traces.planar import wrap
from fitting.windows.prepared import Prepared

#: Numbers of lost frames that are tested; negative numbers are duplicate frames.
LOST_COUNTS = tuple(k for k in range(-20, 61) if k)
#: Number of frames after a jump that are needed to identify it.
FRAMES_AFTER_JUMP = 6
#: Bound of rho.
LARGEST_RHO = 50.0
#: Gain per unit of the remaining misfit above which a jump is tried.
JUMP_GAIN = 40.0
#: Ratio of a window's mean square to the median above which a first fit omits it.
OMITTED_RATIO = 4.0
#: Maximum fraction of the windows that a first fit omits.
MOST_OMITTED = 1 / 3


class Lost(NamedTuple):
    """This number of frames is missing before a frame of a run."""

    run: int
    frame: int
    frames: int


def lost_frames(prepared: Prepared, solution: Solution) -> Lost | None:
    """The jump that explains most, by windows simulated on through the next ones; None if there is no jump.

    Windows left out of the solution start at the end of the previous ones: their own samples contain the jump.
    """
    windows = prepared.windows
    fitted = np.any(solution.windows.known, axis=(1, 2))
    right = np.flatnonzero(windows.follows)
    if not len(right):
        return None
    both = replace(_extend_windows(prepared, right), substeps=solution.windows.substeps)
    starts = pick(starts_from_previous_windows(solution, ~fitted), right - 1)
    found = solution.problem.simulator(solution.values, starts, both).theta
    if not np.isfinite(found).all():
        return None
    best = JUMP_GAIN
    where = None
    half = np.any(windows.known, axis=2).sum(axis=1) // 2  # none of windows that were not fitted
    for pair, times in enumerate(both.times()):
        slots = np.flatnonzero(np.r_[True, np.diff(times) > 0])  # without empty ones at the end
        left = right[pair] - 1
        measured = both.theta[pair, slots], both.weight[pair, slots]
        gain, at, lag = best_jump(found[pair, slots], *measured, half[left] * fitted[left])
        if gain > best:
            run = int(both.run[pair])
            frame = int(np.argmin(np.abs(prepared.traces[run].t - times[slots[at]])))
            best = gain
            where = Lost(run, frame, lag)
    return where


def starts_from_previous_windows(solution: Solution, which: np.ndarray) -> Starts:
    """Starts of all windows; for some (K,) bool the end of the previous window."""
    ends = solution.evaluation.end
    n = ends.shape[1] // 2
    # one after another: if two in a row are left out, the second has no predecessor to start from
    after = np.flatnonzero(which & solution.windows.follows)
    after = after[~which[after - 1]]
    return with_rows(solution.starts, after, Starts(ends[after - 1, :n], ends[after - 1, n:]))


def windows_far_off(solution: Solution) -> np.ndarray:
    """Windows (K,) whose residuals are far larger than those of most; none if there are many."""
    counts = solution.windows.known.sum(axis=(1, 2))
    size = np.sum(solution.errors**2, axis=(1, 2)) / np.maximum(counts, 1)
    off = size > OMITTED_RATIO * np.median(size)
    return off & (off.mean() <= MOST_OMITTED)


def _extend_windows(prepared: Prepared, right: np.ndarray) -> Windows:
    """Windows continued through the next ones, `right` being the first of these, up to twice the longest window.

    They have the noise claimed by the traces: the residuals of a jump would count as noise.
    """
    windows = prepared.windows
    longest = 2 * windows.steps
    pieces = []
    for first in right - 1:
        stop = first + 2  # at least the next one, then as long as windows follow and fit
        while stop < windows.count and windows.follows[stop] and windows.step_counts[first : stop + 1].sum() <= longest:
            stop += 1
        pieces.append(windows.piece(first)._replace(steps=windows.step_counts[first:stop].sum(), follows=False))
    found = fill(prepared.traces, pieces, windows.dt, prepared.sigma)
    return replace(found, released=windows.released[right - 1]).pad_to(longest, 0)


def best_jump(angle: np.ndarray, measured: np.ndarray, weight: np.ndarray, first: int) -> tuple[float, int, int]:
    """Gain, first frame and lost frames of the best jump from slot `first` on; angles (S, n)."""
    plain = _rho(wrap(angle - measured) * weight)
    count = len(angle)
    best = (0.0, 0, 0)
    known = (weight > 0).sum(axis=1)
    for lag in LOST_COUNTS:
        low = max(0, -lag)
        high = min(count, count - lag)
        if high - max(low, first) < FRAMES_AFTER_JUMP:
            continue
        later = _rho(wrap(angle[low + lag : high + lag] - measured[low:high]) * weight[low:high])
        left = _sum_from(later) / np.maximum(_sum_from(known[low:high]), 1)
        gain = _sum_from(plain[low:high] - later) / np.maximum(2 * left, 1.0)
        begin = max(first - low, 0)
        at = begin + int(np.argmax(gain[begin : high - low - FRAMES_AFTER_JUMP + 1]))
        if gain[at] > best[0]:
            best = gain[at], low + at, lag
    return best


def _rho(residual: np.ndarray) -> np.ndarray:
    """Loss (S,) of residuals (S, n), bounded for each sample."""
    return np.minimum(0.5 * residual**2, LARGEST_RHO).sum(axis=1)


def _sum_from(x: np.ndarray) -> np.ndarray:
    """Sums (S,) of the values from each one to the last."""
    return np.cumsum(x[::-1])[::-1]
