"""What residuals in a row say of their noise: correlation of neighbours, innovations, sizes."""

from __future__ import annotations

import numpy as np

#: Largest correlation of neighbouring innovations of noise that is what it is taken for.
WHITE = 0.15


def lag_one(residual: np.ndarray, known: np.ndarray, follows: np.ndarray | None = None) -> tuple[float, float]:
    """Correlation of neighbouring residuals (K, S, n), where both are known, and its standard error for white noise.

    Args:
        follows: whether samples but the first belong to the series of those before them (K, S - 1, n); default: all.
    """
    both = known[:, 1:] & known[:, :-1]
    both = both if follows is None else both & follows
    product = np.where(both, residual[:, 1:] * residual[:, :-1], 0.0)
    square = np.where(known, residual**2, 0.0).sum() / max(known.sum(), 1)
    return float(product.sum() / max(both.sum(), 1) / max(square, 1e-300)), 1 / np.sqrt(max(both.sum(), 1))


def innovations(values: np.ndarray, share: np.ndarray) -> np.ndarray:
    """What AR(1) noise adds from sample to sample: `(v_i - phi_i v_(i-1))/sqrt(1 - phi_i^2)`, the first sample whole.

    Args:
        values: residuals or their derivatives (N, ...).
        share: phi, the part of its noise that each sample hands on to the next (N - 1,).
    """
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.concatenate([values[:1], (values[1:] - share * values[:-1]) / np.sqrt(1 - share**2)])


def correlates(correlation: np.ndarray, error: np.ndarray, deviations: float = 5.0, floor: float = 0.1) -> bool:
    """Whether a positive correlation of neighbours, or any of several, is beyond its standard errors and a floor."""
    return bool(np.any(correlation > np.maximum(deviations * np.asarray(error), floor)))
