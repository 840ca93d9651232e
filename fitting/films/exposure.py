"""Exposure of a film from the lengths of its links, and the positions corrected for it.

A frame exposed for T frames shows the mean position, `p + c d^2p/dt^2` with `c = T^2/24`, of a motion p(t).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fitting.films.lengths import MEDIAN_TO_DEVIATION, link_lengths
from fitting.films.tracked_chain import TrackedChain

#: Number of samples from which a link is used: its mean length is subtracted from them.
MIN_SAMPLES = 10
#: Reweightings of the robust slope.
REWEIGHTINGS = 5
#: Deviations beyond this number of standard deviations count as much as one there.
OUTLYING_DEVIATIONS = 3.0
#: Standard errors of c above which a film is corrected: normal noise reaches them in one film of 30 000.
SIGNIFICANT_ERRORS = 4.0
#: c of an exposure as long as a frame [frame^2], which is the longest.
LARGEST_SHARE = 1 / 24
#: Minimum length [pixel], deviation and its scale [pixel] in divisions; all are below any resolution.
MIN_LENGTH = 1e-9
MIN_DEVIATION = 1e-12
MIN_SCALE = 1e-9


def remove_blur(found: TrackedChain) -> TrackedChain:
    """The positions corrected for a long exposure, with the exposure that the lengths show."""
    positions = found.where_detected(found.flat)
    share = exposure_share(positions)
    flat = found.flat - share * second_differences(positions)
    return replace(found, flat=flat, exposure=float(np.sqrt(24 * share)))


def second_differences(positions: np.ndarray) -> np.ndarray:
    """Second differences (k, n, 2) of the positions (k, n, 2), zero if a neighbour in time is missing (NaN)."""
    return np.pad(np.nan_to_num(np.diff(positions, 2, axis=0)), ((1, 1), (0, 0), (0, 0)))


def exposure_share(positions: np.ndarray) -> float:
    """c of the film [frame^2], 0 if the lengths do not show it.

    A blurred link d has the length `l + c d'' d/|d|`, of a constant l: c is a robust slope.

    Args:
        positions: (k, n, 2), NaN if not detected.
    """
    change = second_differences(positions)
    usable = np.where(change.any(axis=-1, keepdims=True), positions, np.nan)
    length = np.maximum(link_lengths(usable), MIN_LENGTH)
    slope = np.sum(np.diff(change, axis=1) * np.diff(positions, axis=1), axis=-1) / length
    parts = [np.zeros((2, 0))]
    for pair in np.stack([slope, length]).transpose(2, 0, 1):
        known = pair[:, np.isfinite(pair[1])]
        if known.shape[1] >= MIN_SAMPLES:
            parts.append(known - known.mean(axis=1, keepdims=True))
    x, y = np.concatenate(parts, axis=1)
    if not np.sum(x**2) > 0:
        return 0.0
    weight = np.ones_like(x)
    share = 0.0
    for _ in range(REWEIGHTINGS):
        share = np.sum(weight * x * y) / np.sum(weight * x**2)
        off = np.abs(y - share * x)
        scale = MEDIAN_TO_DEVIATION * np.median(off) + MIN_SCALE
        weight = np.minimum(1.0, OUTLYING_DEVIATIONS * scale / np.maximum(off, MIN_DEVIATION))
    error = scale / np.sqrt(np.sum(weight * x**2))
    if not share > SIGNIFICANT_ERRORS * error:  # true for NaN as well
        return 0.0
    return min(share, LARGEST_SHARE)
