"""How well a calibrated model predicts stretches that the fit has not seen."""

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

#: Parts of a held-out window whose angles are used one after another to find its start.
GROWING = (0.2, 0.5, 1.0)


def score_held_out(prepared: Prepared, values: np.ndarray, span: tuple[float, float]) -> HeldOut:
    """RMS angle error [rad] on a span, its starts fitted on its own angles, the parameters held.

    The span is one window where the motion lets its start be found (errors grow by less than exp(6)), else it is cut
    into windows as long as the fit's.
    """
    low, high = span
    whole = prepared.lyapunov * (high - low) < HELD_GROWTH
    pieces = []
    for i, trace in enumerate(prepared.traces):
        part = trace.between(low, high)
        if len(part.t) > 2:
            pieces.append((i, max(low, float(part.t[0])), min(high, float(part.t[-1]) + trace.interval)))
    length = min(end - begin for _, begin, end in pieces) if whole else prepared.windows.length
    windows = prepared.cut(length, pieces)
    windows = replace(windows.padded(*_shape(prepared)), substeps=prepared.windows.substeps)
    return HeldOut(low, high, fit_starts(prepared, windows, values))


def _shape(prepared: Prepared) -> tuple[int, int]:
    """Steps and slots that serve the fit's windows and every held-out span short enough to be one."""
    windows = prepared.windows
    whole = [high - low for low, high in prepared.held_out if prepared.lyapunov * (high - low) < HELD_GROWTH]
    steps = max([windows.steps, *(int(length / windows.dt + 1e-6) for length in whole)])
    samples = max(max(len(trace.between(low, high).t) for trace in prepared.traces) for low, high in prepared.held_out)
    return steps, max(windows.theta.shape[1], samples if steps > windows.steps else 0)


def fit_starts(prepared: Prepared, windows: Windows, values: np.ndarray, iterations: int = 30) -> Solution:
    """Only the starts of windows, on a growing part of each."""
    starts = first_starts(
        prepared.simulator.model_at(values), _seen_only(prepared.traces, windows), windows, prepared.sigma
    )
    problem = replace(prepared.problem(frozen=np.ones(len(values), bool)), windows=windows)
    parts = GROWING if windows.length > 2 * prepared.windows.length else (1.0,)
    for part in parts:
        solution = fit_windows(replace(problem, windows=windows.early(part)), values, starts, iterations=iterations)
        starts = solution.starts
    return solution


def _seen_only(traces: Sequence[Trace], windows: Windows) -> list[Trace]:
    """The traces from the first window on: what was fitted before must not smooth into a held-out start."""
    found = []
    for i, trace in enumerate(traces):
        mine = windows.begin[windows.run == i]
        found.append(trace.between(float(mine.min()), np.inf) if len(mine) else trace)
    return found
