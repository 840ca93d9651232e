"""Stretches at the start and end of a trace in which the line is still: held before its release, or at rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.model import Model
from fitting.estimate.rest import FEWEST_REST_FRAMES
from fitting.estimate.windows import Span
from fitting.traces.conventions import resting_angles
from fitting.traces.planar import wrap
from fitting.traces.trace import Trace
from fitting.windows.spans import Interval


def without_held_starts(
    spans: Sequence[Span],
    traces: Sequence[Trace],
    sigma: Sequence[np.ndarray],
    slowest: float,
    model: Model,
) -> tuple[list[Span], list[str]]:
    """The fitted spans of traces without the still stretch before a release, and a note on each stretch left out.

    Args:
        traces: the samples of every run that may be fitted, the rest missing.
        sigma: noise of each run's links (n,) [rad].
        slowest: period [s] of the line as one pendulum.
        model: of the line, whose ends hold it.
    """
    shortened = list(spans)
    notes = []
    for i, trace in enumerate(traces):
        begin = held_start(trace, sigma[i], slowest, model)
        if begin is None:
            continue
        for j, span in enumerate(shortened):
            if span.run == i:
                shortened[j] = span._replace(low=max(span.low, begin))
        notes.append(
            f"{trace.name} is held still until {begin:.3g} s, in a pose that its own ends do not hold: the fit "
            "starts there"
        )
    return [span for span in shortened if span.low < span.high], notes


#: Length [s] of the shortest still stretch.
SHORTEST_REST = 0.5
#: Length of the shortest still stretch at the start and end of a trace, in periods of the line as one pendulum: a
#: motion is slow at its turning points, and slower as it decays.
FIRST_PERIODS = 0.5
LAST_PERIODS = 2.0
#: Number of frames of the running mean by which a link is still.
MEAN_FRAMES = 5
#: Change of that mean, in its standard deviations, and minimum change [rad], from which a link moves.
STILL_DEVIATIONS = 5.0
SMALLEST_MOVE = 0.002


def still_spans(trace: Trace, sigma: np.ndarray, slowest: float) -> list[Interval]:
    """(from, to) [s] of the trace's first and last stretch at rest; frames without a sample at its ends do not count.

    The first lasts at least half of the slowest period [s], the last at least two periods. A link is still as long as
    the mean of five neighbouring frames stays within five of its standard deviations, at least 2 mrad, of its value at
    that end of the trace. `sigma` (n,) [rad] is the noise of a frame.
    """
    spans: list[Interval] = []
    known = np.flatnonzero(np.isfinite(trace.theta).any(axis=1))
    if not len(known):
        return spans
    whole = slice(known[0], known[-1] + 1)
    for direction, periods in ((1, FIRST_PERIODS), (-1, LAST_PERIODS)):
        times = trace.t[whole][::direction]
        count = still_frames(times, trace.theta[whole][::direction], sigma)
        shortest = max(SHORTEST_REST, periods * slowest)
        if count >= max(FEWEST_REST_FRAMES, 2 * MEAN_FRAMES) and abs(times[count - 1] - times[0]) >= shortest:
            low, high = sorted((times[0], times[count - 1]))
            spans.append((low, high))
    return list(dict.fromkeys(spans))


def still_frames(t: np.ndarray, theta: np.ndarray, sigma: np.ndarray) -> int:
    """Number of still frames at the start of (k, n), up to the first pause of `SHORTEST_REST` without samples."""
    fewest = len(theta)
    for column, size in zip(theta.T, sigma, strict=False):  # the noise of further recordings follows
        known = np.flatnonzero(np.isfinite(column))
        pause = np.abs(np.diff(t[known], prepend=t[0])) > SHORTEST_REST
        if pause.any():
            known = known[: np.argmax(pause)]
        if len(known) < 2 * MEAN_FRAMES:
            return 0
        mean = np.convolve(column[known], np.full(MEAN_FRAMES, 1 / MEAN_FRAMES), "valid")
        # relative to the mean of all still frames so far: the first few alone are too noisy
        before = np.cumsum(mean) / np.arange(1, len(mean) + 1)
        moves = np.flatnonzero(
            np.abs(mean[1:] - before[:-1]) > max(STILL_DEVIATIONS * size / np.sqrt(MEAN_FRAMES), SMALLEST_MOVE)
        )
        still = known[-1] + 1
        if len(moves):
            still = known[moves[0] + 1]
        fewest = min(fewest, still)
    return fewest


#: Angle [rad] between a still pose and equilibrium above which something else must hold the line: errors of 1 % in
#: lengths and ends move the pose of a line between fixed ends by less.
HELD_ANGLE = 0.1


def held_start(trace: Trace, sigma: np.ndarray, slowest: float, model: Model) -> float | None:
    """Time [s] from which the line moves, if something other than its own ends holds it still before.

    It is then not in the model's equilibrium. The frames of the running mean that contain the motion are omitted: the
    line may be released in any of them.
    """
    spans = still_spans(trace, sigma, slowest)
    known = np.flatnonzero(np.isfinite(trace.theta).any(axis=1))
    if not spans or spans[0][0] > trace.t[known[0]]:
        return None
    still = trace.between(spans[0][0], spans[0][1] + 1e-6)
    off = wrap(np.nanmedian(still.theta, axis=0) - resting_angles(model))
    later = known[trace.t[known] > spans[0][1]][MEAN_FRAMES:]
    if len(later) and np.abs(off).max() > HELD_ANGLE:
        return trace.t[later[0]]
    return None


def advice_on_rest(trace: Trace, sigma: np.ndarray, slowest: float) -> list[str]:
    """A line for each stretch at rest that a fit could use as a pose but does not."""
    lines = []
    for low, high in still_spans(trace, sigma, slowest):
        lines.append(
            f"{trace.name} is at rest from {low:.3g} to {high:.3g} s. "
            f"Use --rest {np.ceil(100 * low) / 100:g}:{np.floor(100 * high) / 100:g} to fit that pose as well: it "
            "determines the rig's numbers, if only the scene's own hooks hold the line then"
        )
    return lines
