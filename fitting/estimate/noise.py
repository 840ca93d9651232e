"""Noise of residuals: white, AR(1) or jitter of frames (`whitening` gives its formulas)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.estimate.windows import Windows
from fitting.traces.noise import smooth
from fitting.traces.trace import Trace


@dataclass(frozen=True)
class Noise:
    """The noise of R runs of n links, or of R sensors (n = 1).

    Its samples are windows, or series of sensors, which also have `source`, `follows`, `weight`, `times` and `decay`.

    Attributes:
        factor: ratio of the standard deviation to the claimed one (R, n).
        decay: decay rate of its autocorrelation (R, n) [1/s]; infinite for white noise.
        delay: standard deviation of the frames' delays (R,) [s].
    """

    factor: np.ndarray
    decay: np.ndarray
    delay: np.ndarray

    @classmethod
    def as_claimed(cls, runs: int, links: int) -> Noise:
        """The claimed noise."""
        return cls(np.ones((runs, links)), np.full((runs, links), np.inf), np.zeros(runs))

    @classmethod
    def of_misfit(cls, errors: np.ndarray, claimed: Windows, floor: np.ndarray) -> Noise:
        """White noise as large as errors (K, S, n) [rad] of windows with the claimed noise, at least `floor` (R, n)."""
        noise = cls.as_claimed(*floor.shape)
        square = mean_by_run((errors * claimed.weight) ** 2, claimed, len(floor))
        return replace(noise, factor=np.maximum(np.sqrt(square), floor))

    @property
    def kind(self) -> str:
        """`white`, `correlated` or `jitter`."""
        if np.isfinite(self.decay).any():
            return "correlated"
        if self.delay.any():
            return "jitter"
        return "white"

    def apply_to(self, windows: Windows, traces: Sequence[Trace]) -> Windows:
        """Samples of the claimed noise with this noise; frames with delays need the traces."""
        source = windows.source
        weight = windows.weight / self.factor[source][:, None, :]
        decay = None
        if np.isfinite(self.decay).any():
            decay = self.decay[source]
        if not self.delay.any():
            return replace(windows, weight=weight, decay=decay)
        delay = self.delay[source][:, None, None]
        rate, acceleration = motion(windows, traces)
        theta = windows.theta - 0.5 * delay**2 * acceleration
        return replace(windows, theta=theta, weight=weight, decay=decay, jitter=weight * delay * rate)

    def max_relative_difference(self, other: Noise) -> float:
        """Maximum relative difference of two noises' parts."""
        memory = np.max(np.abs(lag_correlation(self.decay) - lag_correlation(other.decay)), initial=0.0)
        size = _max_log_ratio(self.factor, other.factor)
        return float(max(size, memory, 0.5 * _max_log_ratio(self.delay, other.delay)))


def _max_log_ratio(a: np.ndarray, b: np.ndarray) -> float:
    """Maximum absolute logarithm of the ratios of two arrays, which may be 0."""
    return np.max(np.abs(np.log((a + 1e-9) / (b + 1e-9))), initial=0.0)


def lag_correlation(decay: np.ndarray) -> np.ndarray:
    """Correlation of the noise of samples 1/60 s apart."""
    return np.exp(-decay / 60.0)


#: Half width [s] of the smoother that estimates rates from a trace.
RATE_HALF_WIDTH = 0.05


def motion(windows: Windows, traces: Sequence[Trace]) -> np.ndarray:
    """Rates [rad/s] and accelerations of the links at the windows' samples (2, K, S, n), from smoothed traces."""
    found = np.zeros((2, *windows.theta.shape))
    t = windows.times()
    for run in np.unique(windows.run):
        trace = traces[run]
        mine = windows.run == run
        even = np.arange(trace.t[0], trace.t[-1], trace.interval)
        reach = 2 * max(2, round(RATE_HALF_WIDTH / trace.interval)) + 1
        rate = smooth(trace.at(even), min(reach, 2 * ((len(even) - 1) // 2) + 1), trace.interval)[1]
        for derivative, columns in zip(found, (rate, np.gradient(rate, trace.interval, axis=0)), strict=True):
            for j in range(derivative.shape[2]):  # of every recording
                derivative[mine, :, j] = np.interp(t[mine], even, columns[:, j % trace.links])
    return np.where(windows.weight > 0, found, 0.0)


def mean_by_run(values: np.ndarray, windows: Windows, runs: int) -> np.ndarray:
    """Means (runs, n) over the samples of each run, of values (K, S, n); 0 for runs without any."""
    mine = windows.run == np.arange(runs)[:, None]
    known = windows.known
    return mine @ np.sum(values, axis=1, where=known) / np.maximum(mine @ known.sum(axis=1), 1)
