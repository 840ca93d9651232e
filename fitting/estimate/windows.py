"""Cutting traces into windows, and where each begins.

A chaotic trace cannot be fitted as one run: its sensitivity to the start grows as exp(lambda t). Each window has a
start of its own (angles and rates, in a local chart, see `planar`), and only the parameters are shared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model
from fitting.traces import planar
from fitting.traces.trace import Trace, local_polynomial, without_spikes

#: Departure from whole steps [steps] below which samples count as lying on the time grid.
ON_GRID = 1e-6


#: Part of a step by which rounded times of samples may change it.
ROUNDED = 1e-3


#: What every window has of its own, besides what it follows.
PER_WINDOW = ("begin", "run", "theta", "weight", "index", "fraction", "released")
#: The same, where there is any.
OF_NOISE = ("decay", "jitter")


@dataclass(frozen=True)
class Windows:
    """K windows of S sample slots each, over any number of runs.

    Attributes:
        begin: start times (K,) [s].
        run: number of the trace of each window (K,).
        follows: whether a window begins where the one before it ends (K,).
        theta: measured angles (K, S, n) [rad], 0 where there is none.
        weight: 1/sigma (K, S, n) [1/rad], 0 where there is no sample.
        index, fraction: time of each slot in steps after the start, whole and rest, (K, S).
        dt, steps: time step [s] and steps of a window.
        released: whether the model says where a window begins, see `release` (K,).
        substeps: parts in which every step is taken.
        decay: rate at which noise forgets itself (K, n) [1/s]; None where it is white.
        jitter: deviation by frames' common delays over that of the noise, signed as the rates (K, S, n); None: none.
    """

    begin: np.ndarray
    run: np.ndarray
    follows: np.ndarray
    theta: np.ndarray
    weight: np.ndarray
    index: np.ndarray
    fraction: np.ndarray
    dt: float
    steps: int
    released: np.ndarray
    substeps: int = 1
    decay: np.ndarray | None = None
    jitter: np.ndarray | None = None

    @property
    def count(self) -> int:
        return len(self.begin)

    @property
    def samples(self) -> int:
        """Measured angles in all."""
        return int((self.weight > 0).sum())

    @property
    def free_starts(self) -> int:
        """Windows with a start of their own."""
        return self.count - int(self.released.sum())

    @property
    def length(self) -> float:
        """Duration of a window [s]."""
        return self.steps * self.dt

    def times(self) -> np.ndarray:
        """Times of all slots (K, S) [s]."""
        return self.begin[:, None] + (self.index + self.fraction) * self.dt

    def padded(self, steps: int, slots: int) -> Windows:
        """The same windows simulated for at least `steps` and with at least `slots` sample slots, the rest empty.

        What has the shape of windows that ran before needs no compilation.
        """
        more = max(0, slots - self.theta.shape[1])
        pad = lambda a: np.pad(a, [(0, 0), (0, more), *[(0, 0)] * (a.ndim - 2)])  # noqa: E731
        slotted = ("theta", "weight", "index", "fraction", *(() if self.jitter is None else ("jitter",)))
        part = {f: pad(getattr(self, f)) for f in slotted}
        return replace(self, steps=max(steps, self.steps), **part)

    def early(self, part: float) -> Windows:
        """The same windows, of which only the first part (0 to 1) counts."""
        elapsed = self.index * self.dt / self.length
        return replace(self, weight=self.weight * (elapsed <= part)[:, :, None])

    def pick(self, which: np.ndarray) -> Windows:
        """Some of the windows, none of which follows another."""
        part = {f: getattr(self, f)[which] for f in (*PER_WINDOW, *OF_NOISE) if getattr(self, f) is not None}
        return replace(self, follows=np.zeros(len(part["begin"]), bool), **part)


def check_step(traces: Sequence[Trace], dt: float) -> None:
    """Refuse a step that a caller asks for and that is longer than the samples are apart.

    Between steps angles are interpolated, but a step that passes over samples is a mistyped one: the default is shorter
    than any motion that a camera follows.
    """
    longest = max(trace.interval for trace in traces)
    if not dt <= longest * (1 + 1e-6):
        raise SceneError(f"dt: {dt:g} s is longer than the samples are apart; allowed: at most {longest:.4g} s")


def time_step(traces: Sequence[Trace], wanted: float) -> float:
    """The step [s] nearest below `wanted` that divides the sampling interval, where sampling is uniform.

    Times in files are rounded: a step longer than `wanted` by that rounding is the wanted one.
    """
    intervals = {round(trace.interval, 12) for trace in traces}
    if max(intervals) - min(intervals) > 1e-9:
        return wanted
    interval = max(intervals)
    return interval / max(1, int(np.ceil(interval / wanted - ROUNDED)))


def cut(
    traces: Sequence[Trace],
    length: float,
    dt: float,
    sigma: Sequence[np.ndarray],
    spans: Sequence[tuple[int, float, float]] | None = None,
) -> Windows:
    """Windows of `length` [s], one after another; a rest shorter than one is left out, as is a window without samples.

    Args:
        traces: runs in the model's convention.
        sigma: noise of each run's links (n,) [rad], used where the trace has no standard errors.
        spans: (run, from, to) to cut; default: each run as a whole.
    """
    steps = max(1, int(length / dt + 1e-6))
    length = steps * dt
    spans = spans or [(i, float(tr.t[0]), float(tr.t[-1]) + tr.interval) for i, tr in enumerate(traces)]
    begin, run, follows = [], [], []
    for i, low, high in spans:
        count = int((high - low) / length + 1e-6)
        begin += [low + k * length for k in range(count)]
        run += [i] * count
        follows += [k > 0 for k in range(count)]
    if not begin:
        longest = max((high - low for _, low, high in spans), default=0.0)
        raise SceneError(f"window: {length:g} s is longer than the trace; allowed: at most {longest:g} s")
    parts = [_fill(traces[i], t0, steps, dt, sigma[i]) for i, t0 in zip(run, begin, strict=True)]
    slots = max(len(part[0]) for part in parts)
    pad = lambda a: np.concatenate([a, np.zeros((slots - len(a), *a.shape[1:]), a.dtype)])  # noqa: E731
    theta, weight, index, fraction = (np.stack([pad(part[j]) for part in parts]) for j in range(4))
    released = np.zeros(len(begin), bool)
    numbers = (np.array(begin), np.array(run), np.array(follows), theta, weight, index, fraction)
    return _drop_empty(Windows(*numbers, dt, steps, released))


def _fill(trace: Trace, begin: float, steps: int, dt: float, sigma: np.ndarray) -> tuple[np.ndarray, ...]:
    place = (trace.t - begin) / dt
    keep = (place > -ON_GRID) & (place < steps - ON_GRID)
    place, theta = place[keep], trace.theta[keep]
    index = np.floor(place + ON_GRID).astype(np.int32)
    fraction = place - index
    fraction = np.where(np.abs(fraction) < 10 * ON_GRID, 0.0, fraction)
    known = np.isfinite(theta)
    se = None if trace.se is None else trace.se[keep]
    error = np.broadcast_to(sigma, theta.shape) if se is None else np.where(np.isfinite(se), se, sigma)
    return np.where(known, theta, 0.0), np.where(known, 1.0 / error, 0.0), index, fraction


def _drop_empty(windows: Windows) -> Windows:
    """Without windows in which some link has too few samples to tell where it starts."""
    enough = (windows.weight > 0).sum(axis=1).min(axis=1) >= 2
    if enough.all():
        return windows
    if not enough.any():
        raise SceneError("window: no window has two samples of every link; allowed: longer windows or denser traces")
    follows = windows.follows & np.concatenate([[False], enough[:-1]])
    return replace(windows.pick(enough), follows=follows[enough])


class Starts(NamedTuple):
    """Window starts: angles and rates, each (K, n), which close."""

    theta: np.ndarray
    omega: np.ndarray


def first_starts(model: Model, traces: Sequence[Trace], windows: Windows, smooth: float) -> Starts:
    """Starts from the traces, smoothed over `smooth` [s] on either side of a window's first instant."""
    traces = [without_spikes(trace) for trace in traces]
    value = np.array(
        [
            [local_polynomial(traces[i].t, column, t0, smooth) for column in traces[i].theta.T]
            for i, t0 in zip(windows.run, windows.begin, strict=True)
        ]
    )
    theta, omega = jax.vmap(partial(planar.closed, model))(jnp.asarray(value[..., 0]), jnp.asarray(value[..., 1]))
    return Starts(np.asarray(theta), np.asarray(omega))
