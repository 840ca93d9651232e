"""Faults of single frames: isolated outliers, and frames that are missing without being marked.

Missing frames make the traces jump along the flow: a fitted window, continued through the next one, meets its samples
again that many frames later. The frame f and the number of lost frames k are those that maximise

    sum_{i >= f} rho(r_i) - rho(r_i,k),      r_i,k = (theta(t_i + k dt) - measured_i)/sigma

by which the samples after f fit better (rho is bounded, so that no single sample decides).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fitting.calibration.prepared import Prepared
from fitting.estimate.problem import Solution, wrap_angle
from fitting.estimate.windows import Starts, Windows

#: Numbers of lost frames that are tested; negative numbers are duplicate frames.
LAGS = tuple(k for k in range(-20, 61) if k)
#: Number of frames after a jump that are needed to identify it.
AFTER = 6
#: Bound of rho, and gain per unit of the remaining misfit above which a jump is tried.
BOUND, SHOWN = 50.0, 40.0
#: Ratio of a window's mean square to the median above which a first fit omits it, and the maximum number of omissions.
FAR, FEW = 4.0, 1 / 3
#: Deviations of a sample from the mean of its neighbours above which it is an outlier, and the number of outliers above
#: which they are a kind of noise.
ALONE, SEVERAL = 6.0, 3


class Lost(NamedTuple):
    """This number of frames is missing before a frame of a run."""

    run: int
    frame: int
    frames: int


def alone(solution: Solution) -> int:
    """Number of samples that deviate from the residuals on both sides of them: no smooth misfit does that."""
    windows, count = solution.windows, 0
    residual = solution.errors * windows.weight
    known = windows.weight > 0
    inner = known[:, 1:-1] & known[:, :-2] & known[:, 2:]
    off = np.abs(residual[:, 1:-1] - 0.5 * (residual[:, :-2] + residual[:, 2:]))
    for j in range(residual.shape[2]):
        size = off[..., j][inner[..., j]]
        if not len(size):
            continue
        out = np.where(inner[..., j], off[..., j], 0.0) > ALONE * max(np.median(size) / 0.6745, 1e-300)
        # a neighbour of an outlier deviates half as much
        before = np.concatenate([np.zeros_like(out[:, :1]), out[:, :-1]], axis=1)
        count += int((out & ~before).sum())
    return count


def lost_frames(prepared: Prepared, solution: Solution) -> Lost | None:
    """The jump that explains most, by windows simulated on through the next ones; None if there is no jump.

    Windows left out of the solution start at the end of the previous ones: their own samples contain the jump.
    """
    # with the noise claimed by the traces: the residuals of a jump would count as noise
    windows = replace(prepared.windows, substeps=solution.windows.substeps)
    fitted = (solution.windows.weight > 0).any(axis=(1, 2))
    right = np.flatnonzero(windows.follows)
    if not len(right):
        return None
    both = _extend_windows(windows, right)
    starts = Starts(*(part[right - 1] for part in starts_from_previous_windows(solution, ~fitted)))
    found = solution.problem.simulator(solution.values, starts, both).theta
    if not np.isfinite(found).all():
        return None
    best, where = SHOWN, None
    times = both.times()
    for pair in range(len(right)):
        slots = np.flatnonzero(np.r_[True, np.diff(times[pair]) > 0] & (np.arange(times.shape[1]) >= 0))
        slots = slots[np.argsort(times[pair, slots])]
        angle, measured, weight = found[pair, slots], both.theta[pair, slots], both.weight[pair, slots]
        left = right[pair] - 1
        seen = (windows.weight[left] > 0).any(axis=1).sum() // 2 if fitted[left] else 0
        gain, at, lag = best_jump(angle, measured, weight, seen)
        if gain > best:
            run = int(both.run[pair])
            t = prepared.traces[run].t
            best, where = gain, Lost(run, int(np.argmin(np.abs(t - times[pair, slots[at]]))), lag)
    return where


def starts_from_previous_windows(solution: Solution, which: np.ndarray) -> Starts:
    """Starts of all windows; for some (K,) bool the end of the previous window."""
    starts = Starts(*(part.copy() for part in solution.starts))
    ends, n = solution.evaluation.end, starts.theta.shape[1]
    # one after another: if two in a row are left out, the second has no predecessor to start from
    after = np.flatnonzero(which & solution.windows.follows)
    after = after[~which[after - 1]]
    starts.theta[after], starts.omega[after] = ends[after - 1, :n], ends[after - 1, n:]
    return starts


def far_off(solution: Solution) -> np.ndarray:
    """Windows (K,) whose residuals are far larger than those of most; none if there are many."""
    known = solution.windows.weight > 0
    size = np.sum(np.where(known, solution.errors, 0.0) ** 2, axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1)
    off = size > FAR * np.median(size)
    return off if off.mean() <= FEW else np.zeros_like(off)


def _extend_windows(windows: Windows, right: np.ndarray) -> Windows:
    """Windows continued through the next ones, `right` being the first of these, up to twice the longest window."""
    longest, rows = 2 * windows.steps, []
    for first in right - 1:
        members, total = [first], int(windows.step_counts[first])
        while members[-1] + 1 < windows.count and windows.follows[members[-1] + 1]:
            total += int(windows.step_counts[members[-1] + 1])
            if total > longest and len(members) > 1:
                break
            members.append(members[-1] + 1)
        rows.append(members)
    real = (windows.index + windows.fraction > 0) | (np.arange(windows.theta.shape[1]) == 0)
    before = [np.concatenate([[0], np.cumsum(windows.step_counts[members])]) for members in rows]
    most = max(int(real[members].sum()) for members in rows)

    def join(parts: list[np.ndarray]) -> np.ndarray:
        found = np.concatenate(parts)
        return np.concatenate([found, np.zeros((most - len(found), *found.shape[1:]), found.dtype)])

    def along(field: str, shifts: Sequence[np.ndarray]) -> np.ndarray:
        whole = getattr(windows, field)
        each = zip(rows, shifts, strict=True)
        return np.stack([join([whole[k][real[k]] + s for k, s in zip(m, more, strict=True)]) for m, more in each])

    nothing = [np.zeros(len(members), int) for members in rows]
    joined = {field: along(field, nothing) for field in ("theta", "weight", "fraction")}
    joined["index"] = along("index", [shifts[:-1] for shifts in before]).astype(windows.index.dtype)
    return replace(
        windows,
        **{name: getattr(windows, name)[right - 1] for name in ("begin", "run", "released")},
        **joined,
        follows=np.zeros(len(right), bool),
        steps=longest,
        step_counts=np.array([int(shifts[-1]) for shifts in before]),
        decay=None,
        jitter=None,
    )


def best_jump(angle: np.ndarray, measured: np.ndarray, weight: np.ndarray, first: int) -> tuple[float, int, int]:
    """Gain, first frame and lost frames of the best jump from slot `first` on; angles (S, n)."""
    rho = lambda r: np.minimum(0.5 * r**2, BOUND).sum(axis=1)  # noqa: E731
    plain, count, best = rho(wrap_angle(angle - measured) * weight), len(angle), (0.0, 0, 0)
    known = (weight > 0).sum(axis=1)
    for lag in LAGS:
        low, high = max(0, -lag), min(count, count - lag)
        if high - max(low, first) < AFTER:
            continue
        later = rho(wrap_angle(angle[low + lag : high + lag] - measured[low:high]) * weight[low:high])
        better = np.cumsum((plain[low:high] - later)[::-1])[::-1]
        left = np.cumsum(later[::-1])[::-1] / np.maximum(np.cumsum(known[low:high][::-1])[::-1], 1)
        gain = better / np.maximum(2 * left, 1.0)
        begin = max(first - low, 0)
        at = begin + int(np.argmax(gain[begin : high - low - AFTER + 1]))
        if gain[at] > best[0]:
            best = float(gain[at]), low + at, lag
    return best
