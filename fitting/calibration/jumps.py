"""Faults at an instant: samples that stand out alone, frames that are missing without a mark, kicks and touches.

Where frames are missing the traces jump along the flow: a window that was fitted, simulated on through the next one,
meets its samples again so many frames later. The frame f and the number of lost frames k are those that maximise

    sum_{i >= f} rho(r_i) - rho(r_i,k),      r_i,k = (theta(t_i + k dt) - measured_i)/sigma

by which the samples after f fit better (rho is bounded, so that no single sample decides).

What moves the line at an instant (a kick, a touch) leaves windows that no start explains, whereas those before it are
as good as ever: one window of a kick in the plane, all that follow of one out of it. They are found by least trimmed
squares (Rousseeuw 1984): parameters are fitted to the windows that fit best, all starts to these, and so on until the
same windows are left. Windows that are bad from the first one of a run on are a misfit of another kind.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fitting.calibration.prepared import Prepared
from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.problem import Solution, wrapped
from fitting.estimate.windows import Starts, Windows

#: Lost frames looked for; less than none are frames that are there twice.
LAGS = tuple(k for k in range(-20, 61) if k)
#: Frames after a jump that are needed to tell it.
AFTER = 6
#: Bound of rho, and gain per unit of the misfit that is left, from which on a jump is tried.
BOUND, SEEN = 50.0, 40.0
#: Mean square of a window over the median at which it is left out of a first fit, and how many may be.
FAR, FEW = 4.0, 1 / 3
#: Deviations of a sample from the mean of its neighbours' beyond which it is one of its own, and how many make a kind
#: of noise.
ALONE, SEVERAL = 6.0, 3


#: Part of the windows that a search for kicks begins with and must leave, its rounds, and most evaluations of starts.
TRUSTED, ROUNDS, ITERATIONS = 1 / 3, 5, 12
#: Misfit of a window over that of most, and of the one before it, from which on nothing but a kick explains it: what
#: lengths wrong by 1 % or a wrong law leave differs by less than 4 from one window to the next.
KICKED = 6.0
#: Quantile of a window's residuals that tells its misfit, few outliers aside, and that of normal noise.
QUANTILE, NORMAL = 0.9, 1.645
#: Halvings of the window that tell when it was kicked: to a hundredth of it.
HALVINGS = 6


class Kick(NamedTuple):
    """From `time` [s] of a run on, some windows follow no motion of the model; `lasting`: more than one."""

    run: int
    time: float
    windows: np.ndarray
    lasting: bool


class Lost(NamedTuple):
    """So many frames are missing before a frame of a run."""

    run: int
    frame: int
    frames: int


def alone(solution: Solution) -> int:
    """How many samples stand out from the residuals on both sides of them: no smooth misfit does that."""
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
        # a neighbour of an outlier is half as far off
        before = np.concatenate([np.zeros_like(out[:, :1]), out[:, :-1]], axis=1)
        count += int((out & ~before).sum())
    return count


def lost_frames(prepared: Prepared, solution: Solution) -> Lost | None:
    """The jump that explains most, by windows simulated on through the next ones; None where there is none.

    Windows that the solution left out begin where those before them end: their own samples have the jump among them.
    """
    # as the traces claim their noise: what a jump leaves would be taken for noise
    windows = replace(prepared.windows, substeps=solution.windows.substeps)
    fitted = (solution.windows.weight > 0).any(axis=(1, 2))
    right = np.flatnonzero(windows.follows)
    if not len(right):
        return None
    both = _doubled(windows, right)
    starts = Starts(*(part[right - 1] for part in led(solution, ~fitted)))
    found = solution.problem.simulator(solution.values, starts, both).theta
    if not np.isfinite(found).all():
        return None
    best, where = SEEN, None
    times = both.times()
    for pair in range(len(right)):
        slots = np.flatnonzero(np.r_[True, np.diff(times[pair]) > 0] & (np.arange(times.shape[1]) >= 0))
        slots = slots[np.argsort(times[pair, slots])]
        angle, measured, weight = found[pair, slots], both.theta[pair, slots], both.weight[pair, slots]
        left = right[pair] - 1
        seen = (windows.weight[left] > 0).any(axis=1).sum() // 2 if fitted[left] else 0
        gain, at, lag = _best_jump(angle, measured, weight, seen)
        if gain > best:
            run = int(both.run[pair])
            t = prepared.traces[run].t
            best, where = gain, Lost(run, int(np.argmin(np.abs(t - times[pair, slots[at]]))), lag)
    return where


def led(solution: Solution, which: np.ndarray) -> Starts:
    """Starts of all windows, of some (K,) bool where the windows before them end."""
    starts = Starts(*(part.copy() for part in solution.starts))
    ends, n = solution.evaluation.end, starts.theta.shape[1]
    # one after another: of two that are left out, the second has nothing to begin with
    after = np.flatnonzero(which & solution.windows.follows)
    after = after[~which[after - 1]]
    starts.theta[after], starts.omega[after] = ends[after - 1, :n], ends[after - 1, n:]
    return starts


def far_off(solution: Solution) -> np.ndarray:
    """Windows (K,) whose residuals are far larger than those of most; none where these are many."""
    known = solution.windows.weight > 0
    size = np.sum(np.where(known, solution.errors, 0.0) ** 2, axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1)
    off = size > FAR * np.median(size)
    return off if off.mean() <= FEW else np.zeros_like(off)


def kicks(
    prepared: Prepared, solution: Solution, fit: Callable[[np.ndarray, Solution], Solution]
) -> tuple[list[Kick], Solution]:
    """Kicks in a fit's windows, and the fit without what they spoil.

    Args:
        prepared: with the noise that the traces claim.
        solution: of separate windows.
        fit: one without some windows (K,) bool, from another one.
    """
    claimed = replace(prepared.windows, substeps=solution.windows.substeps)
    size, count = misfit(solution, claimed), claimed.count
    few = int(np.ceil(TRUSTED * count))
    good, clean, starts = size <= np.sort(size)[min(max(few, 2), count) - 1], solution, solution.starts
    if not np.any(size > KICKED * np.median(size[good])):
        return [], solution
    for _ in range(ROUNDS):
        clean = fit(~good, replace(clean, starts=starts))
        own = _only_starts(clean, claimed, clean.starts)
        ahead = _only_starts(clean, claimed, led(own, ~good))
        sizes = misfit(own, claimed), misfit(ahead, claimed)
        better, size = sizes[1] < sizes[0], np.minimum(*sizes)
        starts = Starts(*(np.where(better[:, None], b, a) for a, b in zip(own.starts, ahead.starts, strict=True)))
        before, good = good, size <= KICKED * np.median(size[good])
        if good.sum() < few or (before == good).all():
            break
    # windows that were on a wrong branch, not kicked
    limit, recovered = KICKED * np.median(size[good]), bool((better & good).any())
    while good.sum() >= few:
        own = _only_starts(clean, claimed, starts)
        first = np.flatnonzero(~good & np.r_[True, good[:-1]] & claimed.follows)
        first = first[size[first] > KICKED * size[first - 1]]
        if not len(first):
            break
        times, found, left = _followed(clean, claimed, first, led(own, ~good), limit)
        whole = left <= limit
        if not whole.any():
            return [_kick(claimed, good, k, time) for k, time in zip(first, times, strict=True)], replace(
                clean, starts=starts
            )
        mine, recovered = first[whole], True
        starts.theta[mine], starts.omega[mine] = found.theta[whole], found.omega[whole]
        good[mine], size[mine] = True, left[whole]
    return [], fit(np.zeros(count, bool), replace(clean, starts=starts)) if recovered else solution


def _kick(windows: Windows, good: np.ndarray, k: int, time: float) -> Kick:
    """The kick in window k, with all that it spoils."""
    ends = (j for j in range(k + 1, windows.count) if good[j] or not windows.follows[j])
    last = next(ends, windows.count)
    return Kick(int(windows.run[k]), float(time), np.arange(k, last), last > k + 1)


def misfit(solution: Solution, claimed: Windows) -> np.ndarray:
    """Size of every window's residuals over the claimed noise (K,); 0 of windows without samples."""
    size = np.where(
        claimed.weight > 0, np.abs(wrapped(solution.evaluation.theta - claimed.theta)) * claimed.weight, np.nan
    )
    rows = size.reshape(len(size), -1)
    known = np.isfinite(rows).any(axis=1)
    found = np.zeros(claimed.count)
    found[known] = np.nanquantile(rows[known], QUANTILE, axis=1) / NORMAL
    return found


def _only_starts(solution: Solution, windows: Windows, starts: Starts) -> Solution:
    """The starts of windows alone, at a solution's parameters."""
    held = np.ones(len(solution.values), bool)
    problem = replace(solution.problem, windows=windows, frozen=held, noise=None, memory=1.0)
    return fit_windows(problem, solution.values, starts, iterations=ITERATIONS)


def _followed(
    solution: Solution, windows: Windows, which: np.ndarray, starts: Starts, limit: float
) -> tuple[np.ndarray, Starts, np.ndarray]:
    """Times [s] up to which windows `which` can be followed, by halving; their starts there and misfits as a whole."""
    mine, starts = windows.pick(which), Starts(*(part[which] for part in starts))
    elapsed = mine.times() - mine.begin[:, None]
    low, high = np.zeros(len(which)), np.full(len(which), windows.length)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        early = replace(mine, weight=mine.weight * (elapsed <= middle[:, None])[..., None])
        found = _only_starts(solution, early, starts)
        fine = misfit(found, early) <= limit
        low, high = np.where(fine, middle, low), np.where(fine, high, middle)
        starts = Starts(*(np.where(fine[:, None], a, b) for a, b in zip(found.starts, starts, strict=True)))
    whole = _only_starts(solution, mine, starts)
    return mine.begin + high, whole.starts, misfit(whole, mine)


def _doubled(windows: Windows, right: np.ndarray) -> Windows:
    """Windows that go on through those that follow, by the numbers of the latter."""
    left = right - 1
    join = lambda a, b: np.concatenate([a[left], b[right]], axis=1)  # noqa: E731
    real = (windows.index + windows.fraction > 0) | (np.arange(windows.index.shape[1]) == 0)
    whole = np.where(real, windows.index, windows.steps - 1).astype(windows.index.dtype)
    more = {name: getattr(windows, name)[left] for name in ("begin", "run", "released")}
    return replace(
        windows,
        **more,
        follows=np.zeros(len(left), bool),
        theta=join(windows.theta, windows.theta),
        weight=join(windows.weight, windows.weight),
        index=join(whole, whole + windows.steps),
        fraction=join(windows.fraction, windows.fraction),
        steps=2 * windows.steps,
        decay=None,
        jitter=None,
    )


def _best_jump(angle: np.ndarray, measured: np.ndarray, weight: np.ndarray, first: int) -> tuple[float, int, int]:
    """Gain, first frame after it and lost frames of the best jump from slot `first` on; angles (S, n)."""
    rho = lambda r: np.minimum(0.5 * r**2, BOUND).sum(axis=1)  # noqa: E731
    plain, count, best = rho(wrapped(angle - measured) * weight), len(angle), (0.0, 0, 0)
    known = (weight > 0).sum(axis=1)
    for lag in LAGS:
        low, high = max(0, -lag), min(count, count - lag)
        if high - max(low, first) < AFTER:
            continue
        later = rho(wrapped(angle[low + lag : high + lag] - measured[low:high]) * weight[low:high])
        better = np.cumsum((plain[low:high] - later)[::-1])[::-1]
        left = np.cumsum(later[::-1])[::-1] / np.maximum(np.cumsum(known[low:high][::-1])[::-1], 1)
        gain = better / np.maximum(2 * left, 1.0)
        begin = max(first - low, 0)
        at = begin + int(np.argmax(gain[begin : high - low - AFTER + 1]))
        if gain[at] > best[0]:
            best = float(gain[at]), low + at, lag
    return best
