"""The plane of motion from the motion itself: links are rigid, so their lengths reveal slant and lens distortion.

Pan, pitch, bending k1 and focal length of the map (`flat_map`) minimise the variation in time of the logarithms of the
links' measured lengths, with prior knowledge,

    sum over links and frames of ((log l - mean of log l) / s)^2 + sum of (parameter / its spread)^2,

with s from the residuals themselves. The spreads are those of ordinary cameras. With a calibrated lens or plane they
are the uncertainty left by the boards. Its covariance (a sandwich over blocks of time) is the persistent part of the
angles' errors, which no scatter shows. A roll rotates all angles equally and is not observable: rows are assumed to be
level.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from fitting.films.flat_map import Flat, central_differences
from fitting.films.lengths import MEDIAN_TO_DEVIATION, link_lengths
from fitting.films.video import spread_out

#: Maximum values of pan [rad], pitch [rad], k1 and log(focus / usual).
LIMITS = np.array([0.6, 0.6, 0.6, 0.9])
#: Minimum noise of a circle's centre [pixel].
MIN_NOISE = 0.03
#: Noise of a link's length before any is known [pixel].
FIRST_NOISE = 0.3
#: Maximum number of frames from which the map is learned, and of those that show the level.
MAX_FRAMES = 300
LEVEL_FRAMES = 20
#: Duration of a block [s], over which deviations persist.
BLOCK_DURATION = 0.25


def flatten(pixels: np.ndarray, flat: Flat, fps: float) -> Flat:
    """The map that minimises the variation of the links' lengths.

    Args:
        pixels: (k, n, 2) of the video, NaN if not detected.
    """
    keep = np.flatnonzero(np.isfinite(link_lengths(pixels)).any(axis=1))
    keep = keep[spread_out(len(keep), MAX_FRAMES)]
    positions = pixels[keep]
    lengths = link_lengths(positions)
    both = np.isfinite(lengths)
    spread = flat.spread
    if both.sum() < 10 * len(spread):
        return flat

    def off(parameters: np.ndarray) -> np.ndarray:
        """Deviations (k, n - 1) of the logarithms of the lengths from their means; 0 of links that are not detected."""
        log = np.log(np.maximum(link_lengths(replace(flat, parameters=parameters)(positions)), 1e-9))
        return np.nan_to_num(log - np.nansum(log, axis=0) / np.maximum(both.sum(axis=0), 1))

    def residuals(parameters: np.ndarray, noise: np.ndarray) -> np.ndarray:
        return np.concatenate([(off(parameters) / noise).ravel(), parameters / spread])

    size = np.nanmedian(lengths, axis=0)
    found = np.zeros(len(spread)) if flat.parameters is None else flat.parameters
    noise = FIRST_NOISE / size
    for _ in range(3):
        result = least_squares(
            residuals,
            np.clip(found, -0.9 * LIMITS, 0.9 * LIMITS),
            bounds=(-LIMITS, LIMITS),
            loss="soft_l1",
            args=(noise,),
        )
        found = result.x
        left = np.where(both, np.abs(off(found)), np.nan)
        noise = np.maximum(MEDIAN_TO_DEVIATION * np.nanmedian(left, axis=0), MIN_NOISE / size)
        noise = np.where(np.isfinite(noise), noise, np.nanmedian(noise))
    return replace(flat, parameters=found, covariance=_covariance(off, found, noise, spread, keep, fps))


def level_error(flat: Flat, others: list[Flat], pixels: np.ndarray) -> float:
    """Standard error [rad] of a rotation of the whole picture, which lengths do not show, by the jackknife.

    Args:
        others: the same map with the lens and plane from all pictures of the board but one, for each.
        pixels: (k, n, 2) of the video, NaN if not detected.
    """
    rows = pixels[spread_out(len(pixels), LEVEL_FRAMES)]
    if len(others) < 3 or not len(rows):
        return 0.0
    links = [np.diff(to(rows), axis=1) @ [1.0, 1j] for to in (flat, *others)]
    turns = np.angle([np.nansum(link * links[0].conj()) for link in links[1:]])
    return float(np.sqrt((len(turns) - 1) * np.var(turns)))


def _covariance(
    off: Callable[[np.ndarray], np.ndarray],
    found: np.ndarray,
    noise: np.ndarray,
    spread: np.ndarray,
    keep: np.ndarray,
    fps: float,
) -> np.ndarray:
    """Sandwich over blocks of time: persistent deviations count as often as they change, not once per frame."""
    slopes = central_differences(off, found, 1e-4) / noise[:, None]
    left = np.clip(off(found) / noise, -5.0, 5.0)
    prior = np.diag(1 / spread**2)
    bread = np.linalg.inv(np.einsum("kja,kjb->ab", slopes, slopes) + prior)
    block = (keep / (BLOCK_DURATION * fps)).astype(int)
    score = np.zeros((block.max() + 1, len(found)))
    np.add.at(score, block, np.einsum("kja,kj->ka", slopes, left))
    return bread @ (score.T @ score + prior) @ bread
