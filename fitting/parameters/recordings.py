"""Several recordings of one motion: two cameras, two trackers, an encoder and a film.

The first recording is the reference. Recording r of link j reads, with theta from straight down,

    measured(t) = zero_j + scale theta_j(t - delay)

Its zeros, scale and delay are relative to the reference, whose own are those of the scene's angles and clock. All
recordings have noise of their own, and may differ in rate, duration and in the links that they show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.parameters.parameter import Parameter, StartValues
from fitting.parameters.recording_delay import find_delay, find_zeros
from fitting.parameters.targets import RECORDING, RecordingTarget
from fitting.traces.trace import Trace, convention


class SharedMotion(NamedTuple):
    """One trace with its recordings, the parameters of all but the first, and notes for the user."""

    trace: Trace
    parameters: tuple[Parameter, ...]
    notes: list[str]


def merge_recordings(traces: Sequence[Trace], start: StartValues) -> SharedMotion:
    """The recordings of one motion as one trace in the model's convention, roughly aligned with the first one.

    Args:
        start: start values by path; a recording's delay is searched near its own.

    Raises:
        SceneError: fewer than two recordings, a common name, or recordings that do not overlap.
    """
    if len(traces) < 2:
        raise SceneError("same-motion: one recording; needed: two or more of the same motion")
    names = [trace.name.replace(".", "_") for trace in traces]
    if len(set(names)) < len(names):
        raise SceneError(f"same-motion: recordings of the same name: {', '.join(names)}. Rename a file")
    motion = traces[0]
    recordings = [replace(traces[0], se=traces[0].total_error)]
    parameters: list[Parameter] = []
    notes = [f"{len(traces)} recordings of one motion; zeros, scales and delays are relative to {traces[0].name}"]
    for number, trace in enumerate(traces[1:], start=1):
        stem = f"{RECORDING}.{names[number]}"
        found = find_delay(motion, trace, start.get(f"{stem}.delay"))
        zero = find_zeros(motion, trace, found.value)
        aligned = replace(trace, t=trace.t - found.value, theta=trace.theta - zero, se=trace.total_error)
        if found.alike:
            others = ", ".join(f"{x:.4g}" for x in found.alike)
            notes.append(
                f"{trace.name}: a delay of {others} s fits about as well as {found.value:.4g} s; "
                f"--start {stem}.delay=VALUE chooses another one"
            )
        parameters += recording_parameters(number, stem, trace, zero, found.value)
        recordings.append(aligned)
        motion = fill_gaps(motion, aligned)
    for trace in traces:
        unseen = [f"link {j + 1}" for j in np.flatnonzero(~np.isfinite(trace.theta).any(axis=0))]
        if unseen:
            notes.append(f"{trace.name}: shows nothing of {', '.join(unseen)}")
    error = max(trace.model_error for trace in traces)
    motion = replace(motion, recordings=tuple(recordings), se=None, model_error=error)
    return SharedMotion(motion, tuple(parameters), notes)


def recording_parameters(number: int, stem: str, trace: Trace, zero: np.ndarray, delay: float) -> list[Parameter]:
    """Zeros of the links that a recording shows, its scale and its delay, at paths of this stem."""
    found = []
    for j in np.flatnonzero(np.isfinite(trace.theta).any(axis=0)):
        where = RecordingTarget(number, "zero", int(j), float(zero[j]))
        found.append(Parameter(f"{stem}.zero.{j}", where, float(zero[j]), unit="rad"))
    found.append(Parameter(f"{stem}.scale", RecordingTarget(number, "scale"), 1.0, 0.5, 2.0, unit="rad/rad"))
    where = RecordingTarget(number, "delay", None, delay)
    # a window is run over its own time only: samples may move by two of the recording's intervals
    reach = 2 * trace.interval
    found.append(Parameter(f"{stem}.delay", where, delay, delay - reach, delay + reach, unit="s"))
    return found


def fill_gaps(motion: Trace, trace: Trace) -> Trace:
    """The motion with what a further, aligned recording shows where there was nothing: links, times, missing rows."""
    before = trace.t[trace.t < motion.t[0] - 0.5 * motion.interval]
    after = trace.t[trace.t > motion.t[-1] + 0.5 * motion.interval]
    t = np.concatenate([before, motion.t, after])
    theta = np.full((len(t), motion.links), np.nan)
    theta[len(before) : len(t) - len(after)] = motion.theta
    for j, column in enumerate(theta.T):
        known = np.flatnonzero(np.isfinite(trace.theta[:, j]))
        if not len(known):
            continue
        times = trace.t[known]
        right = np.clip(np.searchsorted(times, t), 1, len(known) - 1)
        apart = times[right] - times[right - 1]
        near = (t >= times[0] - 1e-9) & (t <= times[-1] + 1e-9) & (apart < 3 * trace.interval)
        column[:] = np.where(np.isnan(column) & near, np.interp(t, times, trace.theta[known, j]), column)
    return replace(motion, t=t, theta=theta, convention=convention("horizontal", 1, "rad"))
