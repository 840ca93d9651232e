"""Correlation of neighbouring residuals: whether a noise model leaves any, and whether it is significant."""

from __future__ import annotations

from itertools import product

import numpy as np

from fitting.estimate.windows import Windows

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
