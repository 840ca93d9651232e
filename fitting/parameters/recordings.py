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
from fitting.parameters.targets import RECORDING, RecordingTarget
from fitting.traces.planar import wrap
from fitting.traces.trace import FEWEST_SAMPLES, Trace, convention

#: Number of rows of a recording that are compared with the reference at each delay.
COMPARED_ROWS = 400
#: Maximum number of delays that are compared.
MOST_DELAYS = 20_000
#: Minimum part of the shorter recording that overlaps with the reference.
OVERLAP = 0.5
#: Ratio of the misfit to the best one, below which another delay may be the right one.
ALIKE_RATIO = 1.5
#: Part of the motion that a misfit must exceed to count, because linear interpolation causes as much.
INTERPOLATION_ERROR = 0.003
#: Maximum number of local minima of the misfit that are refined.
MOST_MINIMA = 12
#: Number of steps to either side of a given delay in which it is searched.
NEAR_STEPS = 5
#: Number of steps between two minima from which they are different delays.
DISTINCT_STEPS = 10


class Delay(NamedTuple):
    """Delay [s] of a recording, its misfit [rad], and other delays [s] that fit about as well."""

    value: float
    misfit: float
    alike: tuple[float, ...] = ()


class SharedMotion(NamedTuple):
    """One trace with its recordings, the parameters of all but the first, and notes for the user."""

    trace: Trace
    parameters: tuple[Parameter, ...]
    notes: list[str]


def merge_recordings(traces: Sequence[Trace], start: StartValues | None = None) -> SharedMotion:
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
        found = find_delay(motion, trace, (start or {}).get(f"{RECORDING}.{names[number]}.delay"))
        zero = find_zeros(motion, trace, found.value)
        aligned = replace(trace, t=trace.t - found.value, theta=trace.theta - zero, se=trace.total_error)
        if found.alike:
            others = ", ".join(f"{x:.4g}" for x in found.alike)
            notes.append(
                f"{trace.name}: a delay of {others} s fits about as well as {found.value:.4g} s; "
                f"--start {RECORDING}.{names[number]}.delay=VALUE chooses another one"
            )
        parameters += recording_parameters(number, names[number], trace, zero, found.value)
        recordings.append(aligned)
        motion = fill_gaps(motion, aligned)
    for trace in traces:
        unseen = [f"link {j + 1}" for j in np.flatnonzero(~np.isfinite(trace.theta).any(axis=0))]
        if unseen:
            notes.append(f"{trace.name}: shows nothing of {', '.join(unseen)}")
    error = max(trace.model_error for trace in traces)
    motion = replace(motion, recordings=tuple(recordings), se=None, model_error=error)
    return SharedMotion(motion, tuple(parameters), notes)


def recording_parameters(number: int, name: str, trace: Trace, zero: np.ndarray, delay: float) -> list[Parameter]:
    """Zeros of the links that a recording shows, its scale and its delay."""
    stem = f"{RECORDING}.{name}"
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


def common_links(motion: Trace, trace: Trace) -> np.ndarray:
    """Numbers of the links that both show."""
    return np.flatnonzero(
        (np.isfinite(motion.theta).sum(axis=0) >= FEWEST_SAMPLES)
        & (np.isfinite(trace.theta).sum(axis=0) >= FEWEST_SAMPLES)
    )


def find_delay(motion: Trace, trace: Trace, near: float | None = None) -> Delay:
    """The delay at which a recording follows the motion most closely, apart from its zeros; 0 without a common link.

    Of delays that fit about as well, as after a whole period, the smallest one is taken, or that next to `near` [s].

    Raises:
        SceneError: the recordings do not overlap at any delay.
    """
    links = common_links(motion, trace)
    if not len(links):
        return Delay(near or 0.0, 0.0)
    rows = np.unique(np.linspace(0, len(trace.t) - 1, COMPARED_ROWS).astype(int))
    t = trace.t[rows]
    theta = trace.theta[np.ix_(rows, links)]
    reference = replace(motion, theta=motion.theta[:, links])
    delays, step = _candidate_delays(motion, trace, t, near)
    misfit = np.array([_misfit(reference, t - delay, theta) for delay in delays])
    if np.isinf(misfit).all():
        raise SceneError(f"{trace.name}: does not overlap with the first recording; needed: recordings of one motion")
    tried = [_refine(reference, t, theta, delays[i], step) for i in _best_minima(misfit)]
    most = max(ALIKE_RATIO * min(one.misfit for one in tried), INTERPOLATION_ERROR * _rms_deviation(theta))
    alike = [one for one in tried if one.misfit <= most]
    alike.sort(key=lambda one: abs(one.value - (near or 0.0)))
    others = [one.value for one in alike[1:] if abs(one.value - alike[0].value) > DISTINCT_STEPS * step]
    return alike[0]._replace(alike=tuple(others[:3]))


def _candidate_delays(motion: Trace, trace: Trace, t: np.ndarray, near: float | None) -> tuple[np.ndarray, float]:
    """Delays (m,) [s] at which the times t [s] of a recording overlap with the motion, or those about `near` [s], and
    their step [s]."""
    needed = OVERLAP * min(np.ptp(motion.t), np.ptp(t))
    low = t[0] - motion.t[-1] + needed
    high = t[-1] - motion.t[0] - needed
    step = max(0.5 * min(motion.interval, trace.interval), (high - low) / MOST_DELAYS)
    if near is not None:
        return near + step * np.arange(-NEAR_STEPS, NEAR_STEPS + 1), step
    return np.arange(low, high + step, step), step


def _best_minima(misfit: np.ndarray) -> np.ndarray:
    """Numbers of the local minima of misfits (m,), the best first, `MOST_MINIMA` at most."""
    falls_before = np.r_[True, misfit[1:] <= misfit[:-1]]
    rises_after = np.r_[misfit[:-1] < misfit[1:], True]
    minima = np.flatnonzero(falls_before & rises_after & np.isfinite(misfit))
    return minima[np.argsort(misfit[minima])][:MOST_MINIMA]


def convention_distance(motion: Trace, trace: Trace) -> float:
    """Misfit [rad] of a recording in one of its conventions, its zeros included, at its best delay.

    The mirrored swing half a period later is much the same: the convention of the motion's file is preferred.

    Args:
        trace: in the model's convention, made from the one that it states.
    """
    links = common_links(motion, trace)
    if not len(links):
        return 0.0
    delay = find_delay(motion, trace)
    off = wrap(find_zeros(motion, trace, delay.value)[links])
    distance = float(np.hypot(delay.misfit, np.sqrt(np.mean(off**2))))
    if (trace.convention.zero, trace.convention.sign) == (motion.convention.zero, motion.convention.sign):
        return distance / ALIKE_RATIO
    return distance


def _refine(motion: Trace, t: np.ndarray, theta: np.ndarray, delay: float, step: float) -> Delay:
    """The best delay within a step [s] of another one."""
    fine = delay + np.linspace(-step, step, 41)
    misfit = np.array([_misfit(motion, t - one, theta) for one in fine])
    best = int(np.argmin(misfit))
    return Delay(float(fine[best]), float(misfit[best]))


#: Minimum number of rows of a recording relative to the overlap: too few would fit anything.
ROWS_SHARE = 0.4


def _misfit(motion: Trace, t: np.ndarray, theta: np.ndarray) -> float:
    """RMS [rad] of a recording's angles (k, n) at times (k,) about the motion, each link's mean taken off; infinite
    with too few rows."""
    inside = (t >= motion.t[0]) & (t <= motion.t[-1])
    off = wrap(theta[inside] - motion.at(t[inside]))
    known = np.isfinite(off)
    possible = len(theta) * min(1.0, np.ptp(motion.t) / np.ptp(t))
    if known.sum(axis=0).min() < max(FEWEST_SAMPLES, ROWS_SHARE * OVERLAP * possible):
        return np.inf
    return _rms_deviation(off)


def _rms_deviation(theta: np.ndarray) -> float:
    """RMS [rad] of angles (k, n) about the mean of each link; missing ones are left out."""
    return float(np.sqrt(np.mean(np.nanvar(theta, axis=0))))


def find_zeros(motion: Trace, trace: Trace, delay: float) -> np.ndarray:
    """Zeros (n,) [rad] of a recording's links relative to the motion; 0 of links that the motion lacks."""
    found = np.zeros(trace.links)
    t = trace.t - delay
    inside = (t >= motion.t[0]) & (t <= motion.t[-1])
    for j in common_links(motion, trace):
        column = replace(motion, theta=motion.theta[:, [j]])
        # both are continuous, so that they differ by the same number of whole turns throughout
        found[j] = np.nanmean(trace.theta[inside, j] - column.at(t[inside])[:, 0])
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
