"""Windows that a free start cannot reduce to the noise, as on a wrong branch of a chaotic motion.

A chaotic motion has wrong branches: a link that turns over in the other direction leaves its window far from the
samples, and one such window biases all estimates. A window is lost if

    chi2_k/(N_k - m) > LOST_RATIO max(1, median)    and beyond chance, with its own start fitted, the parameters fixed

(m numbers of a start; chi2_k bounds each sample's contribution, so that outliers do not decide).
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from fitting.estimate.solution import Solution

#: Ratio of a window's mean square residual to that of most windows above which it is lost.
LOST_RATIO = 4.0
#: Probability of such a ratio by noise alone below which it is lost.
LOST_PROBABILITY = 1e-7
#: RMS error [rad] below which no window is lost: rounding and the friction of a bearing deviate less.
LEAST_LOST_ERROR = 2e-3
#: The same if the model itself misses most windows: a wrong branch of a link deviates much more.
BRANCH_ERROR = 0.05
#: Maximum contribution of a sample, as a multiple of the mean square of most windows: one outlier cannot make a window
#: lost. 10 % of the samples must deviate by more than five standard deviations, as on a wrong branch.
LARGEST_SQUARE = 30.0


def lost_windows(solution: Solution) -> np.ndarray:
    """Windows (K,) bool that miss their samples by far more than the noise and than the other windows."""
    windows = solution.windows
    known = windows.known.sum(axis=(1, 2))
    freedom = np.maximum(known - np.where(windows.released, 0, solution.problem.freedoms), 1)
    square = solution.evaluation.residual.reshape(windows.count, -1) ** 2
    unit = _typical_size(square.sum(axis=1) / freedom, known)
    size = np.minimum(square, LARGEST_SQUARE * unit).sum(axis=1) / freedom
    size = np.where(np.isfinite(size), size, np.inf)
    typical = _typical_size(size, known)
    limit = typical * np.maximum(LOST_RATIO, chdtri(freedom, LOST_PROBABILITY) / freedom)
    rms = np.sqrt(np.sum(solution.errors**2, axis=(1, 2)) / np.maximum(known, 1))
    noise = solution.problem.noise
    assumed = 1.0
    if noise is not None:
        assumed = np.mean(noise.factor**2)
    smallest = BRANCH_ERROR
    if typical * assumed < LOST_RATIO / 2:  # the model explains most windows
        smallest = LEAST_LOST_ERROR
    small = rms < smallest  # not of NaN
    return (known > 0) & (size > limit) & ~small


def _typical_size(size: np.ndarray, known: np.ndarray) -> float:
    """The median over the windows with samples, at least 1."""
    if not known.any():
        return 1.0
    return max(1.0, np.median(size[known > 0]))
