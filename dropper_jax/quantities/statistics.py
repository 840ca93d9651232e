"""Statistics of a signal in time: maximum, mean, fatigue, sustained and most probable maximum."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.numerics import trace_once


def _root(x: Array, power: float = 0.5) -> Array:
    """`x**power`, with derivative 0 at 0."""
    return jnp.where(x > 0, jnp.where(x > 0, x, 1.0) ** power, 0.0)


@trace_once
def _fatigue(x: Array) -> Array:
    # slope of the S-N curve in `fatigue`; 3 is usual for ropes and chains (DNV-OS-E301)
    slope = 3.0
    size = jnp.abs(x - jnp.mean(x, axis=0))
    return _root(jnp.mean(size**slope), 1 / slope)


@trace_once
def _peak(x: Array) -> Array:
    if len(x) == 1:  # one sample does not oscillate, and its window has no weight
        return jnp.zeros((), x.dtype)
    weight = 1 - jnp.cos(2 * jnp.pi * jnp.arange(len(x)) / len(x))
    lines = jnp.fft.rfft((x - jnp.mean(x, axis=0)) * weight[:, None], axis=0)
    return 2 * _root(jnp.max(lines.real**2 + lines.imag**2)) / jnp.sum(weight)


@trace_once
def _highest(x: Array) -> Array:
    """The maximum value (times, members): the vertex of the parabola through it and its two neighbours in time.

    The derivative of the largest sample alone is that at a fixed time. Away from the maximum it has an error from the
    slope there, of first order in the step, and of several hundred per cent for short peaks.
    """
    x = x[:, jnp.argmax(jnp.max(x, axis=0))]  # the member with the highest value
    k = jnp.argmax(x)
    # a maximum at an end has no two neighbours: there the vertex is that sample
    around = x[jnp.clip(k + jnp.arange(-1, 2), 0, len(x) - 1)]
    before, top, after = around
    inside = (k > 0) & (k < len(x) - 1)
    bend = 2.0 * top - before - after
    rise = jnp.where(bend > 0, (after - before) ** 2 / (8.0 * jnp.where(bend > 0, bend, 1.0)), 0.0)
    return top + jnp.where(inside, rise, 0.0)


@trace_once
def _std(x: Array) -> Array:
    return _root(jnp.mean((x - jnp.mean(x, axis=0)) ** 2))


#: Length [s] of the means of `sustained`, and of the storm of `mpm`, three hours.
SUSTAINED_TIME = 0.2
STORM_TIME = 10800.0


@trace_once
def _sustained(x: Array, interval: Array | float) -> Array:
    """The maximum over time and members of the means over `SUSTAINED_TIME` of samples (times, members)."""
    end = interval * (1.0 + jnp.arange(len(x)))
    begin = jnp.maximum(end - SUSTAINED_TIME, 0.0)
    times = jnp.append(0.0, end)
    total = interval * jnp.concatenate([jnp.zeros_like(x[:1]), jnp.cumsum(x, axis=0)])
    earlier = jax.vmap(lambda column: jnp.interp(begin, times, column), in_axes=1, out_axes=1)(total)
    means = (total[1:] - earlier) / (end - begin)[:, None]
    # the first windows are shorter; a record that is shorter than one has one mean
    whole = (end >= SUSTAINED_TIME) | (end == end[-1])
    return jnp.max(jnp.where(whole[:, None], means, -jnp.inf))


@trace_once
def _most_probable_maximum(x: Array, interval: Array | float) -> Array:
    """The highest of the members' most probable maxima in a storm, `mean + s sqrt(2 log N)`.

    N is the number of upward crossings of the mean in `STORM_TIME` by a Gaussian process, `s'/(2 pi s)` per second
    (Rice 1944), s and s' the standard deviations of the samples (times, members) and of their rate.
    """
    mean = jnp.mean(x, axis=0)
    variance = jnp.mean((x - mean) ** 2, axis=0)
    rate = jnp.zeros_like(mean)
    if len(x) > 1:
        rate = jnp.mean((jnp.diff(x, axis=0) / interval) ** 2, axis=0)
    varies = (variance > 0.0) & (rate > 0.0)
    crossings = STORM_TIME / (2.0 * jnp.pi) * _root(jnp.where(varies, rate / jnp.where(varies, variance, 1.0), 1.0))
    height = _root(2.0 * jnp.log(jnp.maximum(crossings, 1.0)))
    return jnp.max(mean + jnp.where(varies, height * _root(variance), 0.0))


#: Excess kurtosis from which a process is not Gaussian. Records of 20 waves of one that is have up to 1.
NOT_GAUSSIAN = 1.0


def excess_kurtosis(x: np.ndarray) -> float:
    """Excess kurtosis of the member of samples (times, members) with the largest standard deviation; 0 if Gaussian."""
    member = x[:, np.argmax(np.std(x, axis=0))]
    shift = member - np.mean(member)
    variance = np.mean(shift**2)
    if variance > 0.0:
        return float(np.mean(shift**4) / variance**2 - 3.0)
    return 0.0


#: The statistic of the start alone: for a static start only statics is computed, without a run.
START = "start"
#: The signal that exists only for a start.
PERIOD = "period"

#: Statistics of a signal (times, members). `max` and `min` are vertices of parabolas through three samples; `start`
#: refers to the state at t = 0; `fatigue` is `(mean |x - mean x|^3)^(1/3)`, the amplitude of equal damage at an equal
#: rate of cycles; `peak` is the height of the highest line of the amplitude spectrum (Hann window).
STATISTICS: dict[str, Callable[[Array], Array]] = {
    "max": _highest,
    "min": lambda x: -_highest(-x),
    "mean": jnp.mean,
    "final": lambda x: jnp.mean(x[-1]),
    START: lambda x: jnp.mean(x[0]),
    "std": _std,
    "fatigue": _fatigue,
    "peak": _peak,
}
#: Statistics that need the time between samples: the maximum of the means over 0.2 s, and the most probable maximum in
#: three hours.
IN_TIME: dict[str, Callable[[Array, Array | float], Array]] = {
    "sustained": _sustained,
    "mpm": _most_probable_maximum,
}
#: All names of statistics.
NAMES = (*STATISTICS, *IN_TIME)
#: Statistics of samples that are to be close together.
OF_SAMPLES = ("std", "fatigue", "peak", *IN_TIME)


#: Maxima and minima of rows that are extremes over steps already.
OVER_STEPS: dict[str, Callable[[Array], Array]] = {"max": jnp.max, "min": jnp.min}


def statistic(name: str, x: Array, interval: Array | float, over_steps: bool = False) -> Array:
    """The statistic of samples (times, members) of a signal at times `interval` [s] apart.

    Args:
        over_steps: maxima and minima are those of samples that are extremes over steps (see `OVER_STEPS`).
    """
    if name in IN_TIME:
        return IN_TIME[name](x, interval)
    known = STATISTICS
    if over_steps:
        known = STATISTICS | OVER_STEPS
    return known[name](x)
