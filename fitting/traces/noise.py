"""Noise of a trace: smoothing, single spikes, and the size of the noise from differences of neighbouring samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fitting.traces.trace import FEWEST_SAMPLES, Trace

#: Degree of the polynomials through samples that give angles and rates.
DEGREE = 3


def smooth(theta: np.ndarray, width: int, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Angles and rates (N, n) by cubics through `width` samples around each (Savitzky and Golay 1964); at both ends by
    the last full one."""
    # not by scipy.signal: its import takes half a second of every fit
    half = width // 2
    degrees = np.arange(DEGREE + 1)
    fit = np.linalg.pinv((np.arange(-half, half + 1) * step)[:, None] ** degrees)
    first = np.clip(np.arange(len(theta)) - half, 0, len(theta) - width)
    cubics = np.lib.stride_tricks.sliding_window_view(theta, width, axis=0)[first] @ fit.T
    at = ((np.arange(len(theta)) - first - half) * step)[:, None, None]
    angles = np.sum(cubics * at**degrees, axis=-1)
    rates = np.sum((degrees * cubics)[..., 1:] * at ** degrees[:-1], axis=-1)
    return angles, rates


#: Minimum number of samples of a run.
FEWEST_SMOOTHED_SAMPLES = 120


def smooth_stretch(
    trace: Trace, span: tuple[float, float], reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Equidistant times (k,), smoothed angles and rates (k, n) of a stretch of a trace; None if it is too short.

    Args:
        reach: half width of the smoother [s].
    """
    part = trace.between(*span)
    if len(part.t) < FEWEST_SMOOTHED_SAMPLES:
        return None
    t = np.arange(part.t[0], part.t[-1] + 0.5 * part.interval, part.interval)
    width = 2 * max(2, round(reach / part.interval)) + 1
    return t, *smooth(part.at(t), width, part.interval)


#: Median of the absolute value of a standard normal number.
NORMAL_MEDIAN = 0.6745
#: Distance of a spike from the mean of its neighbours: in standard deviations of all such distances, in steps of the
#: rounding (rounded samples differ by a step without being spikes), and over those of its neighbours (half of its own).
SPIKE_DEVIATIONS = 10.0
SPIKE_STEPS = 2.0
SPIKE_RATIO = 1.5


def without_spikes(trace: Trace) -> Trace:
    """The trace with isolated outliers marked as missing: they are far from both their neighbours."""
    theta = trace.theta.copy()
    for column in theta.T:
        off = np.abs(column[1:-1] - 0.5 * (column[:-2] + column[2:]))
        known = off[np.isfinite(off)]
        near = np.nan_to_num(np.r_[0.0, off, 0.0])
        far = np.inf
        if len(known):
            far = max(SPIKE_DEVIATIONS * np.median(known) / NORMAL_MEDIAN, SPIKE_STEPS * rounding(column))
        column[1:-1][(off > far) & (off > SPIKE_RATIO * np.maximum(near[:-2], near[2:]))] = np.nan
    return replace(trace, theta=theta)


#: Noise [rad] of links with too few samples to show it, and the minimum, whose square keeps its digits.
UNKNOWN_NOISE = 1e-3
LEAST_NOISE = 1e-6
#: Orders of differences tried for the noise; high ones suppress faster motions.
DIFFERENCE_ORDERS = (3, 4, 6, 8)


def noise(trace: Trace) -> np.ndarray:
    """Standard deviation of the noise of each link (n,) [rad], from differences of high order, robust to outliers.

    It is at least the rounding of the samples. Of several recordings of one motion, that of each one's links in turn.
    """
    if trace.recordings:
        return np.concatenate([noise(one) for one in trace.recordings])
    if len(trace.t) < FEWEST_SAMPLES:
        return np.full(trace.links, UNKNOWN_NOISE)
    found = noise_by_differences(trace.theta, trace.t)
    found = np.maximum(np.where(np.isfinite(found), found, UNKNOWN_NOISE), LEAST_NOISE)
    return np.maximum(found, [rounding(column) / np.sqrt(12) for column in trace.theta.T])


def noise_by_differences(values: np.ndarray, t: np.ndarray | None = None) -> np.ndarray:
    """Standard deviation (n,) of white noise on samples (N, n) of a smooth motion; NaN of columns with too few.

    NaN is a missing sample. Columns that lack the same ones are handled together.

    White noise of standard deviation s gives divided differences of unit weights and standard deviation s; those of a
    smooth motion nearly vanish. The minimum over the orders is used, in the calmest blocks of time, and compared with
    the result of the same procedure for white noise of known size. Default for the times t (N,): equidistant.
    """
    if t is None:
        t = np.arange(len(values))
    found = np.full(values.shape[1], np.nan)
    patterns, pattern_of = np.unique(np.isfinite(values), axis=1, return_inverse=True)
    for number, known in enumerate(patterns.T):
        if known.sum() > max(DIFFERENCE_ORDERS):
            columns = pattern_of == number
            white = np.random.default_rng(0).standard_normal((known.sum(), 16))
            expected = np.mean(_calm_difference(white, t[known]))
            found[columns] = _calm_difference(values[known][:, columns], t[known]) / expected
    return found


#: Frames of a block of differences.
BLOCK_FRAMES = 24
#: The calmest blocks determine the noise: links that whip are fast for only part of the time.
CALMEST_FRACTION = 0.35


def _calm_difference(theta: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Size (n,) of the differences of angles (N, n) in the calmest blocks, the minimum over all orders."""
    best = np.full(theta.shape[1], np.inf)
    for order in DIFFERENCE_ORDERS:
        x = np.lib.stride_tricks.sliding_window_view(t - t[0], order + 1, axis=0)
        y = np.lib.stride_tricks.sliding_window_view(theta, order + 1, axis=0)
        weight = 1 / np.prod(x[:, :, None] - x[:, None] + np.eye(order + 1), axis=2)
        size = np.abs(np.einsum("kni,ki->kn", y, weight / np.linalg.norm(weight, axis=1, keepdims=True)))
        blocks = np.array_split(size, max(1, round(len(size) / BLOCK_FRAMES)))
        medians = np.sort([np.median(block, axis=0) for block in blocks], axis=0)
        count = max(1, round(CALMEST_FRACTION * len(medians)))
        best = np.minimum(best, medians[:count].mean(axis=0))
    return best


def column_medians(block: np.ndarray) -> np.ndarray:
    """Medians (n,) of a block's known samples (N, n); NaN of columns without any."""
    some = np.isfinite(block).any(axis=0)
    found = np.full(block.shape[1], np.nan)
    if some.any():
        found[some] = np.nanmedian(block[:, some], axis=0)
    return found


def rounding(column: np.ndarray) -> float:
    """Minimum difference [rad] that the sensor resolves: of the sorted values; nearly zero for unrounded ones."""
    steps = np.diff(np.unique(column[np.isfinite(column)]))
    steps = steps[steps > 1e-9]
    if len(steps):
        return np.min(steps)
    return 0.0
