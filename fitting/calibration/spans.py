"""Spans of time that are fitted, held out or at rest, and checks of the step."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.estimate.still import held_start
from fitting.estimate.windows import Span
from fitting.traces.trace import Trace


def check_step(traces: Sequence[Trace], dt: float) -> None:
    """Reject a requested step that is longer than the sampling interval.

    Between steps angles are interpolated. A step that skips samples is probably a mistyped one: the default is shorter
    than any motion that a camera can follow.
    """
    longest = max(trace.interval for trace in traces)
    if not dt <= longest * (1 + 1e-6):
        raise SceneError(f"dt: {dt:g} s is longer than the sampling interval; allowed: at most {longest:.4g} s")


def check_spans(
    traces: Sequence[Trace], spans: Sequence[tuple[float, float]], option: str = "held-out"
) -> tuple[tuple[float, float], ...]:
    """Sorted spans; messages use the option's name.

    Raises:
        SceneError: a span is empty, overlaps another or lies outside every trace.
    """
    found = sorted((float(low), float(high)) for low, high in spans)
    for i, (low, high) in enumerate(found):
        text = f"{option}: {low:g}:{high:g}"
        if not low < high:
            raise SceneError(f"{text} is empty; allowed: lo < hi")
        if i and low < found[i - 1][1] - 1e-9:
            raise SceneError(f"{text} overlaps {found[i - 1][0]:g}:{found[i - 1][1]:g}. Use separate spans")
        if not any(len(trace.between(low, high).t) > 2 for trace in traces):
            raise SceneError(f"{text} contains no samples; allowed: {traces[0].t[0]:g} to {traces[0].t[-1]:g} s")
    return tuple(found)


def fitted_spans(
    traces: Sequence[Trace],
    until: float | None,
    held_out: Sequence[tuple[float, float]],
    begin: float | None = None,
) -> list[Span]:
    """(run, from, to) of all samples that may be fitted: from `begin` to `until`, outside the held-out spans.

    Raises:
        SceneError: nothing remains.
    """
    found = []
    for i, trace in enumerate(traces):
        if begin is None:
            low = float(trace.t[0])
        else:
            low = max(float(trace.t[0]), begin)
        last = min(float(trace.t[-1]) + trace.interval, np.inf if until is None else until)
        for start, end in [*held_out, (last, last)]:
            if low < min(start, last):
                found.append(Span(i, low, min(start, last)))
            low = max(low, end)
    if not found:
        raise SceneError("from, until, held-out: nothing remains to fit. Use spans that leave part of the trace")
    return found


def without_held_starts(
    spans: Sequence[Span],
    traces: Sequence[Trace],
    sigma: Sequence[np.ndarray],
    slowest: float,
    pose: Callable[[], np.ndarray],
) -> tuple[list[Span], list[str]]:
    """The fitted spans of traces without the still stretch before a release, and a note on each stretch left out.

    Args:
        traces: the samples of every run that may be fitted, the rest missing.
        sigma: noise of each run's links (n,) [rad].
        slowest: period [s] of the line as one pendulum.
        pose: gives the angles (n,) [rad] at rest; only called if a trace starts still.
    """
    found = list(spans)
    notes = []
    for i, trace in enumerate(traces):
        if (begin := held_start(trace, sigma[i], slowest, pose)) is not None:
            found = [span._replace(low=max(span.low, begin)) if span.run == i else span for span in found]
            notes.append(
                f"{trace.name} is held still until {begin:.3g} s, in a pose that its own ends do not hold: the fit "
                "starts there"
            )
    return [span for span in found if span.low < span.high], notes


#: Relative change of a step that rounded times of samples may cause.
ROUNDED_TIMES = 1e-3


def time_step(traces: Sequence[Trace], requested: float) -> float:
    """The step [s] nearest below `requested` that divides the sampling interval, for uniform sampling.

    Times in files are rounded: a step may exceed `requested` by that rounding.
    """
    intervals = [round(trace.interval, 12) for trace in traces]
    if np.ptp(intervals) > 1e-9:
        return requested
    return max(intervals) / max(1, int(np.ceil(max(intervals) / requested - ROUNDED_TIMES)))
