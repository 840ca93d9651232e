"""Noise of residuals: white, AR(1) or jitter of frames; whitening of residuals; correlation of neighbours.

A channel with AR(1) noise keeps `phi = exp(-decay dt)` of it from sample to sample; missing samples give a longer dt:

    u_i = (r_i - phi_i r_{i-1})/sqrt(1 - phi_i^2)

The first sample of a window is independent, u = r. If the window follows another one, its noise is correlated with the
previous sample, which belongs to another start. There `u = sqrt((1 - phi)/(1 + phi)) r`, the information of a sample on
slowly changing quantities. Windows in a row then carry no more information than the run that they were cut from.

A late frame moves every link along its rate. With b the links' rates times the standard deviation of the delay, over
their noise, the covariance of the frame is 1 + b b', and its inverse root

    u = r - (1 - 1/sqrt(1 + b'b)) b (b'r)/(b'b)

Both are linear: derivatives are whitened in the same way. Delays of standard deviation s also move the mean of an
angle, by half of s^2 times its acceleration, which is taken off the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from fitting.estimate.normal_equations import Evaluation
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
    def of_misfit(cls, residual: np.ndarray, mask: np.ndarray, run: np.ndarray, floor: np.ndarray) -> Noise:
        """White noise as large as residuals (K, S, n), in units of the claimed noise, and at least `floor` (R, n)."""
        noise = cls.as_claimed(*floor.shape)
        return replace(noise, factor=np.maximum(np.sqrt(mean_by_run(residual**2, mask, run, len(floor))), floor))

    @property
    def kind(self) -> str:
        """`white`, `correlated` or `jitter`."""
        if np.isfinite(self.decay).any():
            return "correlated"
        if self.delay.any():
            return "jitter"
        return "white"

    def apply_to(self, windows: Windows, traces: Sequence[Trace] = ()) -> Windows:
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


def in_noise_units(evaluation: Evaluation, old: Windows, new: Windows) -> Evaluation:
    """An evaluation in units of the old samples' noise, in those of the new ones."""
    ratio = np.where(new.weight > 0, new.weight / np.where(old.weight > 0, old.weight, 1.0), 0.0)
    residual = evaluation.residual * ratio
    jacobian = evaluation.jacobian * ratio[..., None]
    return evaluation._replace(residual=residual, jacobian=jacobian)


def whiten(windows: Windows, e: Evaluation) -> Evaluation:
    """The evaluation with residuals and derivatives of unit and independent noise."""
    if windows.decay is not None:
        before, phi, size = _memory(windows, windows.decay)
        pick = np.maximum(before, 0)
        previous = np.take_along_axis(e.residual, pick, 1), np.take_along_axis(e.jacobian, pick[..., None], 1)
        residual = size * (e.residual - phi * previous[0])
        return e._replace(residual=residual, jacobian=size[..., None] * (e.jacobian - phi[..., None] * previous[1]))
    if windows.jitter is not None:
        b, share = _late(windows, windows.jitter)
        residual = e.residual - share * b * np.sum(b * e.residual, axis=2, keepdims=True)
        turned = np.einsum("ksn,ksnj->ksj", b, e.jacobian)
        return e._replace(residual=residual, jacobian=e.jacobian - (share * b)[..., None] * turned[:, :, None])
    return e


def log_volume(windows: Windows) -> float:
    """Logarithm of the determinant of the noise's covariance, over all samples [log rad^2]."""
    known = windows.weight > 0
    total = -2 * float(np.sum(np.log(windows.weight[known])))
    if windows.decay is not None:
        total -= 2 * float(np.sum(np.log(_memory(windows, windows.decay)[2][known])))
    if windows.jitter is not None:
        total += float(np.sum(np.log1p(np.sum(_late(windows, windows.jitter)[0] ** 2, axis=2))))
    return total


def _memory(windows: Windows, decay: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For every sample (K, S, n): the previous sample of its channel (-1: none), phi, and the remaining size."""
    known = windows.weight > 0
    slots = np.arange(known.shape[1])[None, :, None]
    last = np.maximum.accumulate(np.where(known, slots, -1), axis=1)
    before = np.concatenate([np.full_like(last[:, :1], -1), last[:, :-1]], axis=1)
    t = np.broadcast_to(windows.times()[..., None], known.shape)
    apart = t - np.take_along_axis(t, np.maximum(before, 0), 1)
    decay = decay[:, None, :]
    first = before < 0
    phi = np.where(first, 0.0, np.exp(-decay * np.maximum(apart, 1e-300)))
    neighbours = (known[:, 1:] & known[:, :-1]).any(2)
    if neighbours.any():
        step = np.median(np.diff(windows.times(), axis=1)[neighbours])
    else:
        step = windows.dt
    usual = np.exp(-decay * step)
    continued = np.where(windows.follows[:, None, None], np.sqrt((1 - usual) / (1 + usual)), 1.0)
    size = np.where(first, continued, 1 / np.sqrt(np.maximum(1 - phi**2, 1e-12)))
    return before, np.where(known, phi, 0.0), np.where(known, size, 0.0)


def _late(windows: Windows, jitter: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """b (K, S, n) of every existing sample, and `(1 - 1/sqrt(1 + b'b))/(b'b)` of its frame (K, S, 1)."""
    b = np.where(windows.weight > 0, jitter, 0.0)
    square = np.sum(b**2, axis=2, keepdims=True)
    root = np.sqrt(1 + square)
    return b, 1 / (root * (1 + root))  # the same, without the division by b'b


def mean_by_run(values: np.ndarray, mask: np.ndarray, run: np.ndarray, runs: int) -> np.ndarray:
    """Means (runs, n) of the values (K, S, n) in a mask, of windows of these runs (K,); 0 for runs without any."""
    mine = run == np.arange(runs)[:, None]
    return mine @ np.sum(values, axis=1, where=mask) / np.maximum(mine @ mask.sum(axis=1), 1)


#: Maximum correlation of neighbouring innovations of a noise model that is accepted.
WHITE_CORRELATION = 0.15


def lag_one(residual: np.ndarray, known: np.ndarray) -> tuple[float, float]:
    """Correlation of neighbouring residuals (K, S, n), where both are known, and its standard error for white noise."""
    both = known[:, 1:] & known[:, :-1]
    product = np.where(both, residual[:, 1:] * residual[:, :-1], 0.0)
    square = np.where(known, residual**2, 0.0).sum() / max(known.sum(), 1)
    return float(product.sum() / max(both.sum(), 1) / max(square, 1e-300)), 1 / np.sqrt(max(both.sum(), 1))


def lag_one_by_source(windows: Windows, residual: np.ndarray, sources: int) -> tuple[np.ndarray, np.ndarray]:
    """`lag_one` of every run and link, or of every sensor: correlations and standard errors (R, n)."""
    known = windows.weight > 0
    found = np.zeros((2, sources, known.shape[2]))
    for r, j in product(np.unique(windows.source), range(known.shape[2])):
        pick = windows.source == r, slice(None), slice(j, j + 1)
        found[:, r, j] = lag_one(residual[pick], known[pick])
    return found[0], found[1]


def is_correlated(
    correlation: np.ndarray | float, error: np.ndarray | float, deviations: float = 5.0, floor: float = 0.1
) -> bool:
    """Whether a positive correlation of neighbours, or any of several, exceeds its standard errors and a floor."""
    return bool(np.any(correlation > np.maximum(deviations * np.asarray(error), floor)))
