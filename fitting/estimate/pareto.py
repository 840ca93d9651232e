"""Importance weights with a smoothed tail, and the tail's shape, which shows whether they are reliable.

The largest weights are replaced by quantiles of a generalised Pareto law fitted to them (Vehtari, Simpson, Gelman, Yao
and Gabry 2024, "Pareto smoothed importance sampling"); its shape is fitted as in Zhang and Stephens (2009). A shape
above 0.7 means that the proposal misses regions of high weight.
"""

from __future__ import annotations

import numpy as np

#: Shape above which averages with these weights are unreliable.
TRUSTED = 0.7
#: Shape towards which a short tail is regularised, and the number of weights that it counts as.
SHORT_TAIL, COUNTS = 0.5, 10


def smooth_weights(log_ratio: np.ndarray) -> tuple[np.ndarray, float]:
    """Weights (N,) that add to 1, and the shape of their tail, from log density over log proposal (N,).

    Non-finite entries have no weight. With fewer than five weights in the tail, the shape is infinite.
    """
    finite = np.isfinite(log_ratio)
    weight = np.zeros(len(log_ratio))
    if not finite.any():
        return weight, np.inf
    weight[finite] = np.exp(log_ratio[finite] - log_ratio[finite].max())
    count = int(finite.sum())
    tail = int(np.ceil(min(0.2 * count, 3 * np.sqrt(count))))
    shape = np.inf
    if tail >= 5:
        order = np.argsort(weight)
        largest, cut = order[-tail:], weight[order[-tail - 1]]
        excess = weight[largest] - cut
        shape = 0.0
        if excess[-1] > 1e-12 and excess[max(int(tail / 4 + 0.5) - 1, 0)] > 0:  # otherwise all weights are equal
            shape, scale = pareto(excess)
            plotting_position = (np.arange(1, tail + 1) - 0.5) / tail
            weight[largest] = np.minimum(cut + quantile(plotting_position, shape, scale), 1.0)
    return weight / weight.sum(), shape


def pareto(excess: np.ndarray) -> tuple[float, float]:
    """Shape and scale of a generalised Pareto law from a sorted sample (n,) above its threshold."""
    n = len(excess)
    many = 30 + int(np.sqrt(n))
    b = 1 / excess[-1] + (1 - np.sqrt(many / (np.arange(1, many + 1) - 0.5))) / (3 * excess[int(n / 4 + 0.5) - 1])
    shapes = np.log1p(-b[:, None] * excess).mean(axis=1)
    likelihood = n * (np.log(-b / shapes) - shapes - 1)
    share = np.exp(likelihood - likelihood.max())
    mean = float(b @ share / share.sum())
    shape = float(np.log1p(-mean * excess).mean())
    scale = -shape / mean
    return (n * shape + COUNTS * SHORT_TAIL) / (n + COUNTS), scale


def quantile(p: np.ndarray, shape: float, scale: float) -> np.ndarray:
    """Quantiles of the generalised Pareto law."""
    if abs(shape) < 1e-9:
        return -scale * np.log1p(-p)
    return scale * np.expm1(-shape * np.log1p(-p)) / shape
