"""Kicks, contacts and out-of-plane motion that starts during a run: detected, reported with their time and left out.

A sudden disturbance leaves windows that no start value explains, while earlier windows fit as well as before. A kick in
the plane affects one window; motion out of the plane affects all that follow. The windows are found by least-trimmed
squares (Rousseeuw 1984): parameters are fitted to the windows that fit best, then all starts to these parameters, until
the selection no longer changes. Windows that are bad from the first one of a run on are a misfit of another kind. This
check runs before lost windows are split, because shorter windows can follow any motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from fitting.calibration.advice import Candidate
from fitting.calibration.jumps import starts_from_previous_windows
from fitting.calibration.prepared import Prepared
from fitting.estimate.gauss_newton import fit_starts
from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.problem import Solution, wrap_angle
from fitting.estimate.windows import Starts, Windows

#: Fraction of the windows that a search starts with and must leave, its rounds, and maximum evaluations of starts.
TRUSTED, ROUNDS, ITERATIONS = 1 / 3, 5, 12
#: Ratio of a window's misfit to that of most, and to the previous one, above which only a kick explains it. The misfit
#: of lengths wrong by 1 % or of a wrong law changes by less than a factor 4 from one window to the next.
KICKED = 6.0
#: Quantile of a window's residuals that measures its misfit regardless of a few outliers, and that of normal noise.
QUANTILE, NORMAL = 0.9, 1.645
#: Halvings of the window that locate the time of the kick: to 1 % of the window.
HALVINGS = 6


class Kick(NamedTuple):
    """From `time` [s] of a run on, some windows follow no motion of the model; `lasting`: more than one."""

    run: int
    time: float
    windows: np.ndarray
    lasting: bool


class Fit(Protocol):
    """Fits a preparation by a method with a loss."""

    def __call__(self, prepared: Prepared, method: str, loss: Loss) -> Solution: ...


def without_kicks(prepared: Prepared, fit: Fit, loss: Loss = LEAST_SQUARES) -> tuple[Prepared, list[Candidate]]:
    """The preparation without the windows that kicks disturb, started from the end of their fit, and their names.

    Args:
        prepared: with the noise claimed by the traces, its windows not yet split.
        fit: an estimator.
    """

    def fit_some(off: np.ndarray, begin: Solution) -> Solution:
        seen = replace(prepared.windows, weight=np.where(off[:, None, None], 0.0, prepared.windows.weight))
        return fit(replace(prepared, windows=seen, begin=begin.values, starts=begin.starts), "windows", loss)

    windows = prepared.windows
    found, clean = find_kicks(windows, fit(prepared, "windows", loss), fit_some)
    if not found:
        return prepared, []
    off = np.isin(np.arange(windows.count), np.concatenate([kick.windows for kick in found]))
    names, removed = [], []
    for kick in found:
        begin, last = float(windows.begin[kick.windows[0]]), float(windows.ends[kick.windows[-1]])
        what = "is disturbed, or moves out of its plane, from" if kick.lasting else "is kicked or touched at"
        words = f"{prepared.traces[kick.run].name} {what} about {kick.time:.2f} s"
        words += f": windows from {begin:.3g} to {last:.3g} s left out"
        names.append(Candidate(words, (), {}, {}, 0.0, 0.0))
        removed.append((kick.run, begin, last))
    starts = Starts(*(part[~off] for part in clean.starts))
    fewer = replace(prepared, windows=windows.exclude(off), starts=starts, begin=clean.values)
    return replace(fewer, left_out=(*prepared.left_out, *removed)), names


def find_kicks(
    claimed: Windows, solution: Solution, fit: Callable[[np.ndarray, Solution], Solution]
) -> tuple[list[Kick], Solution]:
    """Kicks in windows, and the fit without the windows that they disturb.

    Args:
        claimed: the windows with the noise claimed by the traces.
        solution: of separate windows.
        fit: fits without some windows (K,) bool, from another solution.
    """
    claimed = replace(claimed, substeps=solution.windows.substeps)
    size, count = misfit(solution, claimed), claimed.count
    few = int(np.ceil(TRUSTED * count))
    good, clean, starts = size <= np.sort(size)[min(max(few, 2), count) - 1], solution, solution.starts
    if not np.any(size > KICKED * np.median(size[good])):
        return [], solution
    for _ in range(ROUNDS):
        clean = fit(~good, replace(clean, starts=starts))
        own = _only_starts(clean, claimed, clean.starts)
        ahead = _only_starts(clean, claimed, starts_from_previous_windows(own, ~good))
        sizes = misfit(own, claimed), misfit(ahead, claimed)
        better, size = sizes[1] < sizes[0], np.minimum(*sizes)
        starts = Starts(*(np.where(better[:, None], b, a) for a, b in zip(own.starts, ahead.starts, strict=True)))
        before, good = good, size <= KICKED * np.median(size[good])
        if good.sum() < few or (before == good).all():
            break
    limit = KICKED * np.median(size[good])
    while good.sum() >= few:
        # the window of the kick may itself have too few samples
        first = np.flatnonzero(~good & np.r_[True, good[:-1]] & np.r_[False, claimed.run[1:] == claimed.run[:-1]])
        first = first[size[first] > KICKED * size[first - 1]]
        if not len(first):
            break
        own = _only_starts(clean, claimed, starts)
        times, found, left = _fit_following(clean, claimed, first, starts_from_previous_windows(own, ~good), limit)
        whole = left <= limit
        if not whole.any():
            kicked = [_kick(claimed, good, k, time) for k, time in zip(first, times, strict=True)]
            return kicked, replace(clean, starts=starts)
        # on a wrong branch, not kicked
        mine = first[whole]
        starts.theta[mine], starts.omega[mine] = found.theta[whole], found.omega[whole]
        good[mine], size[mine] = True, left[whole]
    return [], solution


def _kick(windows: Windows, good: np.ndarray, k: int, time: float) -> Kick:
    """The kick in window k, with all windows that it disturbs."""
    ends = (j for j in range(k + 1, windows.count) if good[j] or windows.run[j] != windows.run[k])
    last = next(ends, windows.count)
    return Kick(int(windows.run[k]), float(time), np.arange(k, last), last > k + 1)


def misfit(solution: Solution, claimed: Windows) -> np.ndarray:
    """Size of every window's residuals relative to the claimed noise (K,); 0 for windows without samples."""
    error = np.abs(wrap_angle(solution.evaluation.theta - claimed.theta))
    rows = np.where(claimed.weight > 0, error * claimed.weight, np.nan).reshape(claimed.count, -1)
    known = ~np.isnan(rows).all(axis=1)
    found = np.zeros(claimed.count)
    found[known] = np.nanquantile(rows[known], QUANTILE, axis=1) / NORMAL
    return np.where(np.isfinite(found), found, np.inf)


def _only_starts(solution: Solution, windows: Windows, starts: Starts) -> Solution:
    """The starts of windows alone, at a solution's parameters."""
    problem = replace(solution.problem, windows=windows, noise=None, memory=1.0)
    starts, evaluation = fit_starts(problem, solution.values, starts, ITERATIONS)
    return replace(solution, problem=problem, starts=starts, evaluation=evaluation)


def _fit_following(
    solution: Solution, windows: Windows, which: np.ndarray, starts: Starts, limit: float
) -> tuple[np.ndarray, Starts, np.ndarray]:
    """Times [s] up to which windows `which` can be followed, by halving; their starts there and total misfits."""
    mine, starts = windows.pick(which), Starts(*(part[which] for part in starts))
    elapsed = mine.times() - mine.begin[:, None]
    low, high = np.zeros(len(which)), mine.lengths
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        early = replace(mine, weight=mine.weight * (elapsed <= middle[:, None])[..., None])
        found = _only_starts(solution, early, starts)
        fine = misfit(found, early) <= limit
        low, high = np.where(fine, middle, low), np.where(fine, high, middle)
        starts = Starts(*(np.where(fine[:, None], a, b) for a, b in zip(found.starts, starts, strict=True)))
    whole = _only_starts(solution, mine, starts)
    return mine.begin + high, whole.starts, misfit(whole, mine)
