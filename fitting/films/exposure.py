"""Exposure of a film from the lengths of its links, and the positions corrected for it.

A frame exposed for T frames shows the mean position, `p + c d^2p/dt^2` with `c = T^2/24`, of a slow motion p(t). The
edges of a streak are half way between dark and bright, nearer to its middle: a streak as long as a marker's radius is
shifted by 0.6 c along its path and by 0.8 c across it. T from the lengths is then 0.7 to 1 of the shutter's (rendered
films of whipping chains, T of 0.25 to 0.75), and the correction, which has the c of the lengths, is small all the same.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fitting.films.lengths import MEDIAN_TO_DEVIATION
from fitting.films.tracked_chain import TrackedChain

#: Number of samples from which a link is used: its mean length is subtracted from them.
MIN_SAMPLES = 10
#: Reweightings of the robust slope.
REWEIGHTINGS = 5
#: Deviations beyond this number of standard deviations count as much as one there.
OUTLYING_DEVIATIONS = 3.0
#: Standard errors of c above which a film is corrected: normal noise reaches them in one film of 30 000.
SIGNIFICANT_ERRORS = 4.0
#: Number of frames over which deviations of lengths persist. Motion out of the plane also shortens links that turn: its
#: c has more than 6 errors of independent frames, but less than 2 of such blocks.
BLOCK_FRAMES = 15
#: Weights of the frames 1, 2 and 3 before and after in a second derivative [frame^-2], exact for polynomials of degree
#: five. Without the frame itself: its noise is in the length too, and would make c smaller.
NEIGHBOUR_WEIGHTS = (-13 / 24, 2 / 3, -1 / 8)
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
    links = np.diff(positions, axis=1)
    length = np.maximum(np.linalg.norm(links, axis=-1), MIN_LENGTH)
    slope = np.sum(_second_derivatives(links) * links, axis=-1) / length
    known = np.isfinite(slope)
    known &= known.sum(axis=0) >= MIN_SAMPLES
    x = _off_mean(slope, known)
    y = _off_mean(length, known)
    if not np.sum(x**2) > 0:
        return 0.0
    weight = np.ones_like(x)
    share = 0.0
    for _ in range(REWEIGHTINGS):
        share = np.sum(weight * x * y) / np.sum(weight * x**2)
        off = np.abs(y - share * x)
        scale = MEDIAN_TO_DEVIATION * np.median(off[known]) + MIN_SCALE
        weight = np.minimum(1.0, OUTLYING_DEVIATIONS * scale / np.maximum(off, MIN_DEVIATION))
    scores = np.sum(weight * x * (y - share * x), axis=1)
    blocks = np.add.reduceat(scores, np.arange(0, len(scores), BLOCK_FRAMES))
    error = np.sqrt(np.sum(blocks**2)) / np.sum(weight * x**2)
    if not share > SIGNIFICANT_ERRORS * error:
        return 0.0
    return min(share, LARGEST_SHARE)


def _second_derivatives(values: np.ndarray) -> np.ndarray:
    """Second derivatives [frame^-2] of values (k, ...), by three frames before and after; NaN without them."""
    reach = len(NEIGHBOUR_WEIGHTS)
    found = np.full_like(values, np.nan)
    found[reach:-reach] = 0.0
    for distance, weight in enumerate(NEIGHBOUR_WEIGHTS, 1):
        both = values[: -2 * distance] + values[2 * distance :]
        spare = reach - distance
        found[reach:-reach] += weight * both[spare : len(both) - spare]
    return found


def _off_mean(values: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Values (k, m) minus the mean of their column over the `measured` (k, m) ones; 0 for the others."""
    mean = np.sum(values, axis=0, where=measured) / np.maximum(measured.sum(axis=0), 1)
    return np.where(measured, values - mean, 0.0)
