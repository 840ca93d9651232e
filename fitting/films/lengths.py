"""Lengths of links from the positions of nodes, and their statistics over a film."""

from __future__ import annotations

import numpy as np

#: Standard deviation of normal numbers over the median of their absolute values.
MEDIAN_TO_DEVIATION = 1.4826


def link_lengths(positions: np.ndarray) -> np.ndarray:
    """Lengths (k, n - 1) of positions (k, n, 2); NaN unless both ends are known."""
    return np.linalg.norm(np.diff(positions, axis=1), axis=-1)


def detected_links(detected: np.ndarray) -> np.ndarray:
    """Which links (..., n - 1) have both of their nodes (..., n) detected."""
    return detected[..., 1:] & detected[..., :-1]


def robust_lengths(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lengths (k, n - 1) of links, their medians and robust deviations (n - 1,).

    Both are zero for a link that is never detected.

    Args:
        positions: (k, n, 2), NaN if not detected.
    """
    lengths = link_lengths(positions)
    known = np.where(np.isfinite(lengths).any(axis=0), lengths, 0.0)
    usual = np.nanmedian(known, axis=0)
    return lengths, usual, MEDIAN_TO_DEVIATION * np.nanmedian(np.abs(known - usual), axis=0)


def length_statistics(positions: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation (n - 1,) of the links' lengths in the frames `used` (k, n - 1); NaN without any."""
    found = np.full((2, used.shape[1]), np.nan)
    for j in np.flatnonzero(used.any(axis=0)):
        length = link_lengths(positions[:, j : j + 2])[used[:, j]]
        found[:, j] = np.mean(length), np.std(length)
    return found[0], found[1]
