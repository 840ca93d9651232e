"""Trials: short fits of three fifths of every run, scored on the other two fifths, where only the starts are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from fitting.calibration.held_out import score_held_out
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.loss import Loss
from fitting.estimate.noise import Noise
from fitting.estimate.residual_noise import memory_of
from fitting.estimate.solution import Solution
from fitting.estimate.windows import Span, Starts, Windows
from fitting.parameters.parameter import Parameter
from fitting.windows.prepared import Prepared, fitted_parts
from fitting.windows.window_plan import LONGEST_WINDOW

#: Number of parts of a run.
PARTS_OF_RUN = 5
#: Numbers, from 0, of the parts that are scored: one between fitted ones, and the end, where damping counts.
SCORED_PARTS = (2, 4)
#: Maximum evaluations of a trial, which starts near its end.
TRIAL_ITERATIONS = 12


class Trials:
    """Fits of some windows of a preparation, scored on the stretches of the others.

    Args:
        prepared: with a simulator that knows the parameters of all trials.
        loss: of the fits.
        solution: of all windows.
        windows: the solution's, with the noise that the traces claim.

    Attributes:
        spans: the scored stretches.
        used: windows (K,) bool that are fitted.
        claimed: these windows with the noise that the traces claim.
        noise: by the misfit of the last solution that `weigh` was given.
    """

    def __init__(self, prepared: Prepared, loss: Loss, solution: Solution, windows: Windows) -> None:
        scored = scored_windows(prepared)
        self.spans = stretches(prepared, scored)
        self.used = ~scored
        self.loss = loss
        fitted = map(Span, prepared.windows.run, prepared.windows.begin, prepared.windows.ends)
        inside = fitted_parts(prepared.traces, list(fitted))
        self.prepared = replace(prepared, traces=inside, held_out=tuple((low, high) for _, low, high in self.spans))
        self.claimed = prepared.windows.pick(self.used)
        self.weigh(solution, windows)

    def weigh(self, solution: Solution, claimed: Windows) -> None:
        """Weight each link by its misfit and each sample by the memory of the noise, so that priors count.

        Args:
            claimed: the solution's windows with the claimed noise.
        """
        noise = Noise.of_misfit(solution.errors, claimed, self.prepared.floor)
        self.noise = replace(noise, factor=noise.factor * np.sqrt(memory_of(solution)))
        self.prepared = replace(self.prepared, noise=self.noise)

    def fit(self, parameters: Sequence[Parameter], values: np.ndarray, starts: Starts) -> Solution:
        """A short fit of the windows that are not scored, with the noise of the last misfit."""
        at = replace(self.prepared, windows=self.claimed).with_noise(self.noise).with_parameters(parameters, values)
        problem = at.problem(self.loss).with_noise(self.noise, at.windows, values)
        return fit_windows(problem, values, starts, iterations=TRIAL_ITERATIONS)

    def score(self, solution: Solution) -> float:
        """Mean logarithm of the RMS errors [rad] of the windows of all scored stretches."""
        at = self.prepared.with_parameters(solution.problem.parameters, solution.values)
        held = [score_held_out(at, solution.values, (low, high), run).solution for run, low, high in self.spans]
        known = np.concatenate([one.windows.known.sum(axis=(1, 2)) for one in held])
        square = np.concatenate([np.sum(one.errors**2, axis=(1, 2)) for one in held])
        return np.mean(0.5 * np.log(np.maximum(square[known > 0] / known[known > 0], 1e-24)))


def scored_windows(prepared: Prepared) -> np.ndarray:
    """Windows (K,) in the scored parts of their runs; none of runs with too few windows."""
    windows = prepared.windows
    scored = np.zeros(windows.count, bool)
    for i in np.unique(windows.run):
        mine = windows.run == i
        low = windows.begin[mine].min()
        middle = 0.5 * (windows.begin + windows.ends)[mine]
        part = np.floor(PARTS_OF_RUN * (middle - low) / (windows.ends[mine].max() - low))
        scored[mine] = np.isin(part, SCORED_PARTS) & (len(part) >= PARTS_OF_RUN)
    return scored & ~windows.released


def stretches(prepared: Prepared, scored: np.ndarray) -> list[Span]:
    """(run, from, to) of neighbouring scored windows, in equal parts of at most `LONGEST_WINDOW` [s]."""
    windows = prepared.windows
    found: list[Span] = []
    for k in np.flatnonzero(scored):
        span = Span(int(windows.run[k]), windows.begin[k], windows.ends[k])
        if found and scored[k - 1] and windows.follows[k]:
            span = span._replace(low=found.pop().low)
        found.append(span)
    parts = []
    for run, low, high in found:
        edges = np.linspace(low, high, int(np.ceil((high - low) / LONGEST_WINDOW)) + 1).tolist()
        parts += [Span(run, a, b) for a, b in pairwise(edges)]
    return parts
