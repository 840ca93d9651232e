"""Kicks, contacts and out-of-plane motion: detected, reported with their time and left out.

A sudden disturbance leaves windows that no start value explains, while earlier windows fit as well as before. A kick in
the plane affects one window; motion out of the plane affects all that follow. The windows are found by least-trimmed
squares (Rousseeuw 1984): parameters are fitted to the windows that fit best, then all starts to these parameters, until
the selection no longer changes. Windows that are bad from the first one of a run on are a misfit of another kind.

The search uses the windows before lost ones are split, because shorter windows can follow any motion. It runs only if
windows were lost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fitting.calibration.candidate import Candidate
from fitting.estimate.least_squares import fit_starts
from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.solution import Solution
from fitting.estimate.windows import Span, Starts, Windows, pick, with_rows
from fitting.traces.planar import wrap
from fitting.windows.lost_frames import starts_from_previous_windows
from fitting.windows.prepared import Prepared

#: Fraction of the windows that a search starts with and must leave: a kick early in a run may disturb most of them.
TRUSTED_FRACTION = 1 / 3
#: Maximum number of rounds of a search.
SEARCH_ROUNDS = 5
#: Ratio of a window's misfit to that of most, and to the previous one, above which only a kick explains it. The misfit
#: of lengths wrong by 1 % or of a wrong law changes by less than a factor 4 from one window to the next.
KICK_RATIO = 6.0
#: Quantile of a window's absolute residuals that measures its misfit regardless of a few outliers.
MISFIT_QUANTILE = 0.9
#: That quantile of standard normal noise.
NORMAL_QUANTILE = 1.645


class Kick(NamedTuple):
    """From `time` [s] of a run on, some windows follow no motion of the model.

    Samples from `begin` [s] on are left out: the previous window may have some after the kick.
    """

    run: int
    time: float
    begin: float
    windows: np.ndarray


def without_kicks(
    prepared: Prepared, fit: Callable[..., Solution], loss: Loss = LEAST_SQUARES
) -> tuple[Prepared, list[Candidate]]:
    """The preparation without disturbed windows, started from the fit of the others, and a `Candidate` per kick.

    The candidate describes the kick: the run, its time and the windows that are left out.

    Args:
        prepared: with the noise claimed by the traces, its windows not yet split.
        fit: an estimator, such as `estimate`.
    """
    windows = prepared.windows

    def fit_some(off: np.ndarray, begin: Solution) -> Solution:
        some = replace(prepared.starting_at(begin), windows=windows.without_samples(off))
        return _as_claimed(fit(some, "windows", loss), windows)

    found, clean = find_kicks(_as_claimed(fit(prepared, "windows", loss), windows), fit_some)
    if not found:
        return prepared, []
    off = np.isin(np.arange(windows.count), np.concatenate([kick.windows for kick in found]))
    candidates = []
    removed = []
    for kick in found:
        last = windows.ends[kick.windows[-1]]
        what = "is kicked or touched at"
        if len(kick.windows) > 1:
            what = "is disturbed, or moves out of its plane, from"
        name = prepared.traces[kick.run].name
        left_out = f"windows from {kick.begin:.3g} to {last:.3g} s left out"
        candidates.append(Candidate(f"{name} {what} about {kick.time:.2f} s: {left_out}"))
        removed.append(Span(kick.run, kick.begin, last))
        if kick.begin < windows.begin[kick.windows[0]]:
            windows = windows.end_early(kick.windows[0] - 1, kick.begin)
    fewer = replace(prepared, windows=windows.exclude(off), starts=pick(clean.starts, ~off), begin=clean.values)
    return replace(fewer, left_out=(*prepared.left_out, *removed)), candidates


def _as_claimed(solution: Solution, claimed: Windows) -> Solution:
    """A solution whose windows have all their samples, with the noise claimed by the traces."""
    windows = replace(claimed, substeps=solution.windows.substeps)
    return replace(solution, problem=replace(solution.problem, windows=windows, noise=None, memory=1.0))


def find_kicks(solution: Solution, fit: Callable[[np.ndarray, Solution], Solution]) -> tuple[list[Kick], Solution]:
    """Kicks in windows, and the fit without the windows that they disturb.

    Args:
        solution: of separate windows.
        fit: fits without some windows (K,) bool, from another solution.
    """
    trimmed = _trimmed_fit(solution, fit)
    if trimmed is None:
        return [], solution
    kicks, clean = _locate_kicks(trimmed, solution.windows)
    if not kicks:
        return [], solution
    return kicks, clean


class _TrimmedFit(NamedTuple):
    """A fit to the windows that fit best.

    Attributes:
        solution: parameters of the good windows, and starts of all windows at them.
        misfit: of all windows (K,).
        good: whether each window is among them (K,).
    """

    solution: Solution
    misfit: np.ndarray
    good: np.ndarray

    @property
    def limit(self) -> float:
        """Misfit above which only a kick explains a window."""
        return KICK_RATIO * np.median(self.misfit[self.good])


def _min_windows(windows: Windows) -> int:
    """Minimum number of good windows."""
    return int(np.ceil(TRUSTED_FRACTION * windows.count))


def _trimmed_fit(solution: Solution, fit: Callable[[np.ndarray, Solution], Solution]) -> _TrimmedFit | None:
    """The fit to the windows that fit best, in rounds until they no longer change; None if all windows fit alike."""
    windows = solution.windows
    size = misfit(solution)
    min_windows = _min_windows(windows)
    good = size <= np.sort(size)[min(max(min_windows, 2), windows.count) - 1]
    clean = solution
    if not np.any(size > KICK_RATIO * np.median(size[good])):
        return None
    for _ in range(SEARCH_ROUNDS):
        clean = fit(~good, clean)
        from_own_start = _only_starts(clean, windows, clean.starts)
        starts = starts_from_previous_windows(from_own_start, ~good)
        from_previous_window = _only_starts(clean, windows, starts)
        own_size = misfit(from_own_start)
        previous_size = misfit(from_previous_window)
        better = previous_size < own_size
        size = np.minimum(own_size, previous_size)
        starts = with_rows(from_own_start.starts, better, pick(from_previous_window.starts, better))
        clean = replace(clean, starts=starts)
        before = good
        good = size <= KICK_RATIO * np.median(size[good])
        if good.sum() < min_windows or (before == good).all():
            break
    return _TrimmedFit(clean, size, good)


def _locate_kicks(trimmed: _TrimmedFit, windows: Windows) -> tuple[list[Kick], Solution]:
    """Kicks in windows, and the fit with the starts found on the way; none if bad windows continue previous ones.

    A bad window that continues the previous one up to its end was fitted on a wrong branch and is not kicked.
    """
    clean = trimmed.solution
    size = trimmed.misfit.copy()
    good = trimmed.good.copy()
    limit = trimmed.limit
    while good.sum() >= _min_windows(windows):
        follows_good = np.r_[True, good[:-1]]
        same_run = np.r_[False, windows.run[1:] == windows.run[:-1]]
        # the window of the kick may itself have too few samples
        first = np.flatnonzero(~good & follows_good & same_run)
        first = first[size[first] > KICK_RATIO * size[first - 1]]
        if not len(first):
            break
        from_own_start = _only_starts(clean, windows, clean.starts)
        starts = starts_from_previous_windows(from_own_start, ~good)
        times, continued = _fit_following(clean, first, starts, limit)
        left = misfit(continued)
        recovered = left <= limit
        if not recovered.any():
            early = np.minimum(times, _first_missed(clean, first - 1, clean.starts, limit))
            return _kicks_at(windows, first, early, good), clean
        mine = first[recovered]
        clean = replace(clean, starts=with_rows(clean.starts, mine, pick(continued.starts, recovered)))
        good[mine] = True
        size[mine] = left[recovered]
    return [], clean


def _kicks_at(windows: Windows, first: np.ndarray, times: np.ndarray, good: np.ndarray) -> list[Kick]:
    """A kick in each of the windows `first`, at these times [s], and the bad windows of the run up to a good one."""
    found = []
    for k, time in zip(first, times, strict=True):
        others = np.flatnonzero(good[k:] | (windows.run[k:] != windows.run[k]))
        last = k + min(others, default=windows.count - k)
        begin = min(time, windows.begin[k])
        found.append(Kick(int(windows.run[k]), time, begin, np.arange(k, last)))
    return found


def _first_missed(solution: Solution, which: np.ndarray, starts: Starts, limit: float) -> np.ndarray:
    """Times [s] from which windows `which`, before kicks, miss their last frames; infinite if they explain them.

    A window's misfit is a quantile of its residuals, which a kick in its last frames does not change. They are
    predicted from the other frames. Frames that are missing around a kick leave such a window.
    """
    mine = solution.windows.pick(which)
    known = mine.known.any(axis=2)
    late = known & (np.cumsum(known, axis=1) > MISFIT_QUANTILE * known.sum(axis=1, keepdims=True))
    found = _only_starts(solution, mine.with_slots(~late), pick(starts, which))
    error = np.abs(wrap(found.evaluation.theta - mine.theta)) * mine.weight
    missed = late & ~(error < limit).all(axis=2)
    return np.where(missed, mine.times(), np.inf).min(axis=1)


def misfit(solution: Solution) -> np.ndarray:
    """Size of every window's residuals relative to its noise (K,); 0 for windows without samples."""
    windows = solution.windows
    error = np.abs(solution.errors) * windows.weight
    rows = np.where(windows.known, error, np.nan).reshape(windows.count, -1)
    known = ~np.isnan(rows).all(axis=1)
    found = np.zeros(windows.count)
    found[known] = np.nanquantile(rows[known], MISFIT_QUANTILE, axis=1) / NORMAL_QUANTILE
    return np.where(np.isfinite(found), found, np.inf)


def _only_starts(solution: Solution, windows: Windows, starts: Starts) -> Solution:
    """The starts of windows alone, at a solution's parameters."""
    problem = replace(solution.problem, windows=windows)
    evaluation = fit_starts(problem, solution.values, starts)
    return replace(solution, problem=problem, starts=evaluation.starts, evaluation=evaluation)


#: Halvings of the window that locate the time of the kick: to 1 % of the window.
HALVINGS = 6


def _fit_following(solution: Solution, which: np.ndarray, starts: Starts, limit: float) -> tuple[np.ndarray, Solution]:
    """Times [s] up to which windows `which` continue from these starts, by halving, and the windows in full."""
    mine = solution.windows.pick(which)
    starts = pick(starts, which)
    elapsed = mine.times() - mine.begin[:, None]
    low = np.zeros(len(which))
    high = mine.lengths
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        found = _only_starts(solution, mine.with_slots(elapsed <= middle[:, None]), starts)
        fine = misfit(found) <= limit
        low = np.where(fine, middle, low)
        high = np.where(fine, high, middle)
        starts = with_rows(starts, fine, pick(found.starts, fine))
    return mine.begin + high, _only_starts(solution, mine, starts)
