"""Stretches of time that a fit does not use, and those that remain to be fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.estimate.resting import held_start
from fitting.traces.trace import Trace


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
    traces: Sequence[Trace], until: float | None, held_out: Sequence[tuple[float, float]]
) -> list[tuple[int, float, float]]:
    """(run, from, to) of all samples that may be fitted: before `until`, outside the held-out spans.

    Raises:
        SceneError: nothing remains.
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
        raise SceneError("until, held-out: nothing remains to fit. Use spans that leave part of the trace")
    return found


def fitted_parts(traces: Sequence[Trace], spans: Sequence[tuple[int, float, float]]) -> list[Trace]:
    """The traces with every sample outside the spans (run, from, to) [s] marked as missing."""
    found = []
    for i, trace in enumerate(traces):
        inside = np.zeros(len(trace.t), bool)
        for run, low, high in spans:
            inside |= (run == i) & (trace.t >= low - 1e-9) & (trace.t < high - 1e-9)
        found.append(replace(trace, theta=np.where(inside[:, None], trace.theta, np.nan)))
    return found


def without_held_starts(
    spans: Sequence[tuple[int, float, float]],
    traces: Sequence[Trace],
    sigma: Sequence[np.ndarray],
    slowest: float,
    pose: Callable[[], np.ndarray],
) -> tuple[list[tuple[int, float, float]], list[str]]:
    """The fitted spans of traces without the still stretch before a release, and a note on each stretch left out.

    Args:
        traces: the samples of every run that may be fitted, the rest missing.
        sigma: noise of each run's links (n,) [rad].
        slowest: period [s] of the line as one pendulum.
        pose: gives the angles (n,) [rad] at rest; only called if a trace starts still.
    """
    found, notes = list(spans), []
    for i, trace in enumerate(traces):
        begin = held_start(trace, sigma[i], slowest, pose)
        if begin is None:
            continue
        left = [(run, max(low, begin) if run == i else low, high) for run, low, high in found]
        found = [(run, low, high) for run, low, high in left if low < high]
        notes.append(
            f"{trace.name} is held still until {begin:.3g} s, in a pose that its own ends do not hold: the fit starts "
            "there"
        )
    return found, notes
