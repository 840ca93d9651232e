"""Spans of time that are fitted, held out or at rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.estimate.windows import Span
from fitting.traces.trace import Trace

#: From, to [s].
Interval = tuple[float, float]
#: Minimum number of frames of a span: a start and one residual.
LEAST_FRAMES = 3
#: Overlap of two spans that counts as rounding [s].
TIME_ROUNDING = 1e-9


def check_spans(traces: Sequence[Trace], spans: Sequence[Interval], option: str = "held-out") -> tuple[Interval, ...]:
    """Sorted spans; messages use the option's name.

    Raises:
        SceneError: a span is not two times, is empty, overlaps another or lies outside every trace.
    """
    try:
        ordered = sorted((float(low), float(high)) for low, high in spans)
    except (TypeError, ValueError):
        raise SceneError(f"{option}: {spans!r} has no spans; allowed: (from, to) in s, one after another") from None
    for i, (low, high) in enumerate(ordered):
        text = f"{option}: {low:g}:{high:g}"
        if not low < high:
            raise SceneError(f"{text} is empty; allowed: lo < hi")
        if i and low < ordered[i - 1][1] - TIME_ROUNDING:
            raise SceneError(f"{text} overlaps {ordered[i - 1][0]:g}:{ordered[i - 1][1]:g}. Use separate spans")
        if not any(frames_between(trace, low, high) >= LEAST_FRAMES for trace in traces):
            times = ", ".join(f"{trace.t[0]:g} to {trace.t[-1]:g} s" for trace in traces)
            raise SceneError(f"{text} has fewer than {LEAST_FRAMES} measured frames; allowed: spans of {times}")
    return tuple(ordered)


def frames_between(trace: Trace, low: float, high: float) -> int:
    """Number of frames from `low` to `high` [s] in which an angle is measured."""
    return int(np.isfinite(trace.between(low, high).theta).any(axis=1).sum())


def fitted_spans(
    traces: Sequence[Trace],
    until: float | None,
    held_out: Sequence[Interval],
    begin: float | None,
) -> list[Span]:
    """(run, from, to) of all samples that may be fitted: from `begin` to `until`, outside the held-out spans.

    Raises:
        SceneError: a limit is not a number, or nothing remains.
    """
    for option, limit in (("from", begin), ("until", until)):
        if limit is not None and np.isnan(limit):
            raise SceneError(f"{option}: {limit} is not a time; allowed: a number in s")
    spans = []
    for i, trace in enumerate(traces):
        low = trace.t[0]
        if begin is not None:
            low = max(low, begin)
        last = trace.t[-1] + trace.interval
        if until is not None:
            last = min(last, until)
        for start, end in [*held_out, (last, last)]:
            if low < min(start, last):
                spans.append(Span(i, low, min(start, last)))
            low = max(low, end)
    if not spans:
        raise SceneError("from, until, held-out: nothing remains to fit. Use spans that leave part of the trace")
    return spans
