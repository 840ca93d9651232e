"""Outliers: samples that deviate from the motion far more than the others, which no smooth misfit causes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fitting.estimate.least_squares import fit_starts
from fitting.estimate.solution import Solution
from fitting.estimate.windows import Windows, pick, with_rows
from fitting.traces.noise import NORMAL_MEDIAN
from fitting.traces.planar import wrap
from fitting.windows.lost_windows import lost_windows
from fitting.windows.prepared import Prepared

#: Deviation of a sample from the mean of its neighbours, in standard deviations, above which it is an outlier.
OUTLIER_DEVIATIONS = 6.0
#: Minimum number of outliers that are taken for a kind of noise.
SEVERAL_OUTLIERS = 3


def count_outliers(solution: Solution) -> int:
    """Number of samples that deviate from the residuals on both sides of them: no smooth misfit does that."""
    windows = solution.windows
    # frames that are late move fast links by many times the noise, which the whitened residuals allow for
    if windows.jitter is None:
        residual = solution.errors * windows.weight
    else:
        residual = solution.evaluation.residual
    known = windows.known
    inner = known[:, 1:-1] & known[:, :-2] & known[:, 2:]
    off = np.abs(residual[:, 1:-1] - 0.5 * (residual[:, :-2] + residual[:, 2:]))
    usual = np.ma.median(np.ma.array(off, mask=~inner), axis=(0, 1)) / NORMAL_MEDIAN
    out = inner & (off > OUTLIER_DEVIATIONS * np.maximum(np.ma.filled(usual, np.inf), 1e-300))
    # a neighbour of an outlier deviates half as much: of several in a row the first counts
    follows_another = np.zeros_like(out)
    follows_another[:, 1:] = out[:, :-1]
    return int((out & ~follows_another).sum())


#: Maximum number of samples that are removed from a window as outliers.
MOST_REMOVED = 3


def isolated_outliers(solution: Solution, lost: np.ndarray) -> np.ndarray:
    """Samples (K, S, n) bool without which lost windows (K,) are no longer lost.

    One outlier pulls the start of its window, and so all residuals there. The sample of largest residual is removed and
    the start fitted again, as long as the window is lost. At a jump of the motion neighbours deviate too, and no sample
    is an outlier.
    """
    trial = solution
    for _ in range(MOST_REMOVED):
        trial = _without_largest(trial, np.flatnonzero(lost & lost_windows(trial)))
    known = trial.windows.known
    removed = solution.windows.known & ~known
    mean_square = np.sum(trial.evaluation.residual**2, axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1)
    usual = np.sqrt(np.maximum(mean_square, 1.0))[:, None, None]
    off = wrap(trial.evaluation.theta - trial.windows.theta) * solution.windows.weight
    isolated = np.abs(off) > OUTLIER_DEVIATIONS * usual
    isolated[:, 1:-1] &= known[:, :-2] & known[:, 2:]
    isolated[:, [0, -1]] = False
    explained = ~lost_windows(trial) & ~np.any(removed & ~isolated, axis=(1, 2))
    return removed & explained[:, None, None]


def _without_largest(solution: Solution, which: np.ndarray) -> Solution:
    """The solution without the sample of largest residual of some windows (numbers), whose starts are fitted again."""
    if not len(which):
        return solution
    weight = solution.windows.weight.copy()
    for k in which:
        size = np.abs(solution.evaluation.residual[k])
        weight[k][np.unravel_index(np.argmax(size), size.shape)] = 0.0
    problem = replace(solution.problem, windows=replace(solution.windows, weight=weight))
    few = replace(problem, windows=problem.windows.pick(which))
    found = fit_starts(few, solution.values, pick(solution.starts, which))
    starts = with_rows(solution.starts, which, found.starts)
    return replace(solution, problem=problem, starts=starts, evaluation=with_rows(solution.evaluation, which, found))


def mark_as_missing(prepared: Prepared, windows: Windows, outlying: np.ndarray) -> Prepared:
    """The preparation whose traces lack samples (K, S, n) bool of these windows, which are named."""
    traces = list(prepared.traces)
    names = list(prepared.outliers)
    for k, slot, column in np.argwhere(outlying):
        run = windows.run[k]
        time = windows.times()[k, slot]
        names.append(f"{traces[run].column_name(column)} at {time:.3f} s")
        traces[run] = traces[run].with_missing(time, column)
    return replace(prepared, traces=traces, outliers=tuple(names))


#: Residual, in standard deviations, above which a sample is reported: one in 2 million of normal noise.
LISTED_DEVIATIONS = 5.0
#: Maximum number of samples that are reported one by one.
NAMED_SAMPLES = 5


def outlier_warnings(prepared: Prepared, solution: Solution) -> list[str]:
    """Lines on outliers, those that are not fitted and those that are, with run, link and time."""
    found = []
    if prepared.outliers:
        found.append(f"isolated outliers are not fitted: {', '.join(prepared.outliers)}. Check these samples")
    windows = solution.windows
    residual = np.ma.array(np.abs(solution.evaluation.residual), mask=~windows.known)
    # the median gives the spread of the residuals themselves, which outliers do not widen
    spread = np.ma.median(residual, axis=(0, 1)) / NORMAL_MEDIAN
    size = np.ma.filled(residual / np.maximum(spread, 1e-300), 0.0)
    out = np.argwhere(size > LISTED_DEVIATIONS)
    if not len(out):
        return found
    largest_first = np.argsort(-size[tuple(out.T)])
    positions = []
    for window, slot, column in out[largest_first[:NAMED_SAMPLES]]:
        trace = prepared.traces[windows.run[window]]
        positions.append(f"{trace.column_name(column)} at {windows.times()[window, slot]:.3f} s")
    more = ""
    if len(out) > len(positions):
        more = f" and {len(out) - len(positions)} more"
    advice = ". Use --student to reduce their weight"
    if solution.problem.loss.redescends:
        advice = ""
    found.append(
        f"{len(out)} samples stand out by more than {LISTED_DEVIATIONS:g} standard deviations: "
        f"{', '.join(positions)}{more}{advice}"
    )
    return found
