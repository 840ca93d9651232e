"""How well a fit predicts stretches of the traces that it has not used: only the starts are fitted there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fitting.estimate.first_starts import first_starts
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.solution import Solution
from fitting.estimate.windows import Span, Windows, fewest_frames
from fitting.windows.prepared import Prepared, program_space
from fitting.windows.spans import Interval, frames_between


@dataclass(frozen=True)
class HeldOut:
    """A stretch of trace that was not fitted; only its starts were, on its own angles."""

    low: float
    high: float
    solution: Solution

    @property
    def windows(self) -> Windows:
        """Windows of the span, of all runs."""
        return self.solution.windows

    @property
    def rms(self) -> float:
        """RMS angle error [rad]."""
        return self.solution.rms


def score_held_out(prepared: Prepared, values: np.ndarray, span: Interval, run: int | None = None) -> HeldOut:
    """A span of one run, by default of all, with its starts fitted on its own angles and the parameters fixed.

    All windows have one length, which the shortest piece of a run limits. A run with too few frames to determine a
    start is left out, unless all are: windows that short fit any angles.
    """
    low, high = span
    frames = [frames_between(trace, low, high) for trace in prepared.traces]
    if run is not None:
        frames = [count * (i == run) for i, count in enumerate(frames)]
    needed = min(fewest_frames(prepared.traces[0].links, prepared.simulator.freedoms), max(frames))
    pieces = []
    for i, trace in enumerate(prepared.traces):
        if frames[i] >= needed:
            part = trace.between(low, high)
            end = min(high, part.t[-1] + trace.interval)
            pieces.append(Span(i, max(low, part.t[0]), end))
    shortest = min(piece.high - piece.low for piece in pieces)
    windows = prepared.cut(min(window_length(prepared, span), shortest), pieces).pad_to(*_shape(prepared))
    return HeldOut(low, high, fit_starts_in_parts(prepared, windows, values))


#: Maximum growth of an error over a held-out window, in e-folds: its start must still be found.
HELD_GROWTH = 6.0


def window_length(prepared: Prepared, span: Interval) -> float:
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
    steps, slots = program_space(prepared.traces, longest, windows.dt)
    if steps <= windows.steps:
        return windows.steps, windows.theta.shape[1]
    return steps, max(windows.theta.shape[1], slots)


#: Maximum evaluations for the starts of held-out windows, at each part of them.
START_ITERATIONS = 30
#: Parts of a held-out window whose angles are used in turn: the start must be near the motion to follow all of it.
FITTED_PARTS = (0.2, 0.5, 1.0)


def fit_starts_in_parts(prepared: Prepared, windows: Windows, values: np.ndarray) -> Solution:
    """Fit only the starts of windows, on a growing fraction of each."""
    traces = list(prepared.traces)
    for i in np.unique(windows.run):  # earlier fitted samples must not affect the smoothing of a held-out start
        traces[i] = traces[i].between(np.min(windows.begin[windows.run == i]), np.inf)
    starts = first_starts(prepared.simulator.model_at(values), traces, windows, prepared.sigma)
    problem = prepared.problem(frozen=np.ones(len(values), bool))
    problem = replace(problem, windows=windows, simulator=problem.simulator.view_of_starts())
    for part in FITTED_PARTS:
        solution = fit_windows(
            replace(problem, windows=windows.early(part)), values, starts, iterations=START_ITERATIONS
        )
        starts = solution.starts
    return solution
