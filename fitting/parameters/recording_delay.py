"""Delay and zeros of a further recording of one motion, relative to the first one."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.traces.planar import wrap
from fitting.traces.trace import FEWEST_SAMPLES, Trace

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
#: Minimum number of rows of a recording relative to the overlap: too few would fit anything.
ROWS_SHARE = 0.4


class Delay(NamedTuple):
    """Delay [s] of a recording, its misfit [rad], and other delays [s] that fit about as well."""

    value: float
    misfit: float
    alike: tuple[float, ...] = ()


def common_links(motion: Trace, trace: Trace) -> np.ndarray:
    """Numbers of the links that both show."""
    counts = [np.isfinite(one.theta).sum(axis=0) for one in (motion, trace)]
    return np.flatnonzero(np.minimum(*counts) >= FEWEST_SAMPLES)


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
    misfit = _misfits(reference, t, theta, delays)
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
    distance = np.hypot(delay.misfit, np.sqrt(np.mean(off**2)))
    if (trace.convention.zero, trace.convention.sign) == (motion.convention.zero, motion.convention.sign):
        return distance / ALIKE_RATIO
    return distance


def _refine(motion: Trace, t: np.ndarray, theta: np.ndarray, delay: float, step: float) -> Delay:
    """The best delay within a step [s] of another one."""
    fine = delay + np.linspace(-step, step, 41)
    misfit = _misfits(motion, t, theta, fine)
    best = np.argmin(misfit)
    return Delay(float(fine[best]), float(misfit[best]))


def _misfits(motion: Trace, t: np.ndarray, theta: np.ndarray, delays: np.ndarray) -> np.ndarray:
    """The `_misfit` of a recording at each of these delays (m,) [s]."""
    return np.array([_misfit(motion, t - delay, theta) for delay in delays])


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
    return np.sqrt(np.mean(np.nanvar(theta, axis=0)))


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
