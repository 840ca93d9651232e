"""Fits of short windows with their starts and the damping free: how well a scene explains a trace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.estimate.first_starts import first_starts
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.windows import Span
from fitting.parameters.names import DAMPING_PATHS
from fitting.traces.noise import without_spikes
from fitting.traces.trace import Trace
from fitting.windows.prepared import Prepared

#: Number of short windows: as many as one program runs in parallel.
SHORT_WINDOWS = 8
#: Length of a short window in the shortest link's periods and in frames, the larger of both. An acceleration that is
#: wrong by g moves a link by a radian in that time.
WINDOW_PERIODS = 0.35
WINDOW_FRAMES = 6
#: Evaluations of short windows.
SHORT_WINDOW_ITERATIONS = 4
#: Fraction of the samples of a window that count; the largest of the others may be outliers.
COUNTED_FRACTION = 0.95


class Misfit(NamedTuple):
    """What a fit of short windows misses.

    Attributes:
        chi2: chi-square per sample (K,).
        part: median over the windows of the RMS error, as a fraction of the RMS motion.
        values: parameters (k,).
    """

    chi2: np.ndarray
    part: float
    values: np.ndarray


def fit_short_windows(
    prepared: Prepared, pieces: Sequence[Span], paths: Sequence[str] = (), traces: Sequence[Trace] | None = None
) -> Misfit:
    """Short windows fitted with their starts, damping and the parameters at `paths` free.

    Of a fit's parameters only the damping is fitted, starting from zero: a wrong file makes all others arbitrary.

    Args:
        pieces: run, start and end [s] of the windows.
        traces: other ones than those of the preparation.
    """
    at = replace(prepared, traces=[without_spikes(trace) for trace in traces or prepared.traces])
    try:
        windows = at.cut(min(high - low for _, low, high in pieces), pieces)
    except SceneError:
        return Misfit(np.array([np.inf]), np.inf, prepared.values)
    names = prepared.names
    damping = np.array([name.startswith(DAMPING_PATHS) for name in names])
    free = damping | [name.startswith(tuple(paths)) for name in names]
    values = np.where(damping, [p.low for p in prepared.parameters], prepared.values)
    starts = first_starts(prepared.simulator.model_at(values), at.traces, windows, at.sigma)
    problem = replace(at.problem(frozen=~free), windows=windows)
    solution = fit_windows(problem, values, starts, iterations=SHORT_WINDOW_ITERATIONS)
    weight = windows.weight
    mean = np.sum(weight * windows.theta, axis=1) / np.maximum(weight.sum(axis=1), 1e-300)
    chi2 = _mean_square(solution.errors * weight, weight)
    moved = _mean_square((windows.theta - mean[:, None]) * weight, weight)
    chi2 = np.where(np.isfinite(chi2), chi2, np.inf)
    part = np.median(np.sqrt(chi2 / np.maximum(moved, 1e-300)))
    return Misfit(chi2, part, solution.values)


def _mean_square(size: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Mean square (K,) of windows' samples (K, S, n), without the largest, which may be outliers."""
    found = []
    for one, known in zip(size, weight > 0, strict=True):
        square = np.sort(one[known] ** 2)
        counted = int(np.ceil(COUNTED_FRACTION * len(square)))
        found.append(square[:counted].mean())
    return np.array(found)


def moving_pieces(prepared: Prepared) -> list[Span]:
    """Run, start and end of short windows, spread over those of the fit's that move more than the median."""
    windows = prepared.windows
    interval = max(trace.interval for trace in prepared.traces)
    length = min(windows.length, max(WINDOW_PERIODS * prepared.period, WINDOW_FRAMES * interval))
    known = windows.known
    mean = np.sum(windows.theta * known, axis=1) / np.maximum(known.sum(axis=1), 1)
    moved = np.sum(known * (windows.theta - mean[:, None]) ** 2, axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1)
    moved = np.where(windows.lengths > length * (1 - 1e-6), moved, -1.0)  # the rest of a window is too short
    moving = np.flatnonzero((moved >= np.median(moved[moved >= 0])) & (moved >= 0))
    some = moving[np.unique(np.linspace(0, len(moving) - 1, SHORT_WINDOWS).round().astype(int))]
    begins = zip(windows.run[some].tolist(), windows.begin[some].tolist(), strict=True)
    return [Span(run, begin, begin + length) for run, begin in begins]
