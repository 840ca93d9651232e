"""How well a calibrated model predicts stretches that the fit has not used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fitting.calibration.prepared import Prepared
from fitting.calibration.result import HeldOut
from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.lyapunov import HELD_GROWTH
from fitting.estimate.problem import Solution
from fitting.estimate.windows import Windows, first_starts
from fitting.traces.trace import Trace

#: Fractions of a held-out window whose angles are used in turn to find its start.
GROWING = (0.2, 0.5, 1.0)


def score_held_out(
    prepared: Prepared, values: np.ndarray, span: tuple[float, float], runs: Sequence[int] | None = None
) -> HeldOut:
    """RMS angle error [rad] on a span of some runs, by default of all; starts are fitted on the span's own angles, the
    parameters are fixed."""
    low, high = span
    pieces = []
    for i, trace in enumerate(prepared.traces):
        if runs is not None and i not in runs:
            continue
        part = trace.between(low, high)
        if len(part.t) > 2:
            pieces.append((i, max(low, float(part.t[0])), min(high, float(part.t[-1]) + trace.interval)))
    length = min(window_length(prepared, span), *(end - begin for _, begin, end in pieces))
    windows = prepared.cut(length, pieces)
    windows = replace(windows.pad_to(*_shape(prepared)), substeps=prepared.windows.substeps)
    return HeldOut(low, high, fit_starts(prepared, windows, values))


def window_length(prepared: Prepared, span: tuple[float, float]) -> float:
    """Length [s] of the windows that score a span: equal parts, short enough for their starts to be found.

    Errors grow by at most exp(6) over each window. The growth rate is that of the scene along the measured motion, not
    that of the fit. Shorter windows alone would lower a score, so two fits must be scored with the same windows.
    """
    low, high = span
    return (high - low) / max(1, int(np.ceil(prepared.lyapunov * (high - low) / HELD_GROWTH - 1e-9)))


def _shape(prepared: Prepared) -> tuple[int, int]:
    """Steps and slots that suffice for the fit's windows and those of every held-out span."""
    windows = prepared.windows
    longest = max(window_length(prepared, span) for span in prepared.held_out)
    steps = max(windows.steps, int(longest / windows.dt + 1e-6))
    samples = int(longest / min(trace.interval for trace in prepared.traces) + 1.5)
    return steps, max(windows.theta.shape[1], samples if steps > windows.steps else 0)


def fit_starts(prepared: Prepared, windows: Windows, values: np.ndarray, iterations: int = 30) -> Solution:
    """Fit only the starts of windows, on a growing fraction of each."""
    starts = first_starts(
        prepared.simulator.model_at(values), _from_first_window(prepared.traces, windows), windows, prepared.sigma
    )
    problem = prepared.problem(frozen=np.ones(len(values), bool))
    problem = replace(problem, windows=windows, simulator=problem.simulator.view_of_starts())
    for part in GROWING:
        solution = fit_windows(replace(problem, windows=windows.early(part)), values, starts, iterations=iterations)
        starts = solution.starts
    return solution


def _from_first_window(traces: Sequence[Trace], windows: Windows) -> list[Trace]:
    """The traces from the first window on: earlier fitted samples must not affect the smoothing of a held-out start."""
    found = []
    for i, trace in enumerate(traces):
        mine = windows.begin[windows.run == i]
        found.append(trace.between(float(mine.min()), np.inf) if len(mine) else trace)
    return found
