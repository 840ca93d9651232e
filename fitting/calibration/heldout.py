"""Stretches that a fit never sees: what is left to fit, and how well the calibrated model predicts the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.calibration.result import HeldOut
from fitting.estimate.gauss_newton import Solution, fit_windows
from fitting.estimate.lyapunov import HELD_GROWTH
from fitting.estimate.windows import Windows, cut, first_starts
from fitting.traces.trace import Trace

if TYPE_CHECKING:
    from fitting.calibration.preparation import Prepared

#: Parts of a held-out window whose angles are used one after another to find its start.
GROWING = (0.2, 0.5, 1.0)


def check_spans(traces: Sequence[Trace], spans: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Sorted held-out spans.

    Raises:
        SceneError: a span that is empty, overlaps another or lies outside every trace.
    """
    found = sorted((float(low), float(high)) for low, high in spans)
    for i, (low, high) in enumerate(found):
        text = f"held-out: {low:g}:{high:g}"
        if not low < high:
            raise SceneError(f"{text} is empty; allowed: lo < hi")
        if i and low < found[i - 1][1] - 1e-9:
            raise SceneError(f"{text} overlaps {found[i - 1][0]:g}:{found[i - 1][1]:g}; allowed: spans apart")
        if not any(len(trace.between(low, high).t) > 2 for trace in traces):
            raise SceneError(f"{text} holds no samples; allowed: {traces[0].t[0]:g} to {traces[0].t[-1]:g} s")
    return tuple(found)


def fitted_spans(
    traces: Sequence[Trace], until: float | None, held_out: Sequence[tuple[float, float]]
) -> list[tuple[int, float, float]]:
    """(run, from, to) of everything that may be fitted: before `until`, outside the held-out spans.

    Raises:
        SceneError: nothing left.
    """
    found = []
    for i, trace in enumerate(traces):
        low, last = float(trace.t[0]), float(trace.t[-1]) + trace.interval
        last = last if until is None else min(last, until)
        for begin, end in held_out:
            if low < min(begin, last):
                found.append((i, low, min(begin, last)))
            low = max(low, end)
        if low < last:
            found.append((i, low, last))
    if not found:
        raise SceneError("until, held-out: leave nothing to fit; allowed: spans that leave some of the trace")
    return found


def only(trace: Trace, spans: Sequence[tuple[float, float]]) -> Trace:
    """The trace with every sample outside the spans [s] missing."""
    inside = np.zeros(len(trace.t), bool)
    for low, high in spans:
        inside |= (trace.t >= low - 1e-9) & (trace.t < high - 1e-9)
    return replace(trace, theta=np.where(inside[:, None], trace.theta, np.nan))


def score_held_out(prepared: Prepared, values: np.ndarray, span: tuple[float, float]) -> HeldOut:
    """RMS angle error [rad] on a span, its starts fitted on its own angles, the parameters held.

    The span is one window where the motion lets its start be found (errors grow by less than exp(6)), else it is cut
    into windows as long as the fit's.
    """
    low, high = span
    whole = prepared.lyapunov * (high - low) < HELD_GROWTH
    dt = prepared.windows.dt
    pieces = []
    for i, trace in enumerate(prepared.traces):
        part = trace.between(low, high)
        if len(part.t) > 2:
            pieces.append((i, max(low, float(part.t[0])), min(high, float(part.t[-1]) + trace.interval)))
    length = min(end - begin for _, begin, end in pieces) if whole else prepared.windows.length
    windows = cut(prepared.traces, length, dt, prepared.sigma, pieces)
    windows = replace(windows.padded(*_shape(prepared)), substeps=prepared.windows.substeps)
    solution = fit_starts(prepared, windows, values)
    known = windows.weight > 0
    raw = np.where(known, solution.evaluation.residual / np.where(known, windows.weight, 1.0), 0.0)
    return HeldOut(low, high, float(np.sqrt(np.sum(raw**2) / known.sum())), solution, windows)


def _shape(prepared: Prepared) -> tuple[int, int]:
    """Steps and slots that serve the fit's windows and every held-out span short enough to be one."""
    windows = prepared.windows
    whole = [high - low for low, high in prepared.held_out if prepared.lyapunov * (high - low) < HELD_GROWTH]
    steps = max([windows.steps, *(int(length / windows.dt + 1e-6) for length in whole)])
    samples = max(max(len(trace.between(low, high).t) for trace in prepared.traces) for low, high in prepared.held_out)
    return steps, max(windows.theta.shape[1], samples if steps > windows.steps else 0)


def fit_starts(prepared: Prepared, windows: Windows, values: np.ndarray, iterations: int = 30) -> Solution:
    """Only the starts of windows, on a growing part of each."""
    simulator = prepared.simulator
    starts = first_starts(
        simulator.model_at(values), _seen_only(prepared.traces, windows), windows, 0.12 * prepared.period
    )
    frozen = np.ones(len(values), bool)
    elapsed = windows.index * windows.dt / windows.length
    parts = GROWING if windows.length > 2 * prepared.windows.length else (1.0,)
    for part in parts:
        seen = replace(windows, weight=windows.weight * (elapsed <= part)[:, :, None])
        solution = fit_windows(simulator, seen, values, starts, frozen=frozen, iterations=iterations)
        starts = solution.starts
    return solution


def _seen_only(traces: Sequence[Trace], windows: Windows) -> list[Trace]:
    """The traces from the first window on: what was fitted before must not smooth into a held-out start."""
    found = []
    for i, trace in enumerate(traces):
        mine = windows.begin[windows.run == i]
        found.append(trace.between(float(mine.min()), np.inf) if len(mine) else trace)
    return found
