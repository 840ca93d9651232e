"""Outliers: samples that deviate from the motion far more than the others, which no smooth misfit causes."""

from __future__ import annotations

import numpy as np

from fitting.estimate.solution import Solution
from fitting.traces.noise import NORMAL_MEDIAN
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


#: Residual, in standard deviations, above which a sample is reported: one in 2 million of normal noise.
LISTED_DEVIATIONS = 5.0
#: Maximum number of samples that are reported one by one.
NAMED_SAMPLES = 5


def outlier_warnings(prepared: Prepared, solution: Solution) -> list[str]:
    """A line on outlying samples, with run, link and time, if there are any."""
    windows = solution.windows
    residual = np.ma.array(np.abs(solution.evaluation.residual), mask=~windows.known)
    # the median gives the spread of the residuals themselves, which outliers do not widen
    spread = np.ma.median(residual, axis=(0, 1)) / NORMAL_MEDIAN
    size = np.ma.filled(residual / np.maximum(spread, 1e-300), 0.0)
    out = np.argwhere(size > LISTED_DEVIATIONS)
    if not len(out):
        return []
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
    return [
        f"{len(out)} samples stand out by more than {LISTED_DEVIATIONS:g} standard deviations: "
        f"{', '.join(positions)}{more}{advice}"
    ]
