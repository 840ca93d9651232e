"""The plane of motion from the motion itself: links are rigid, so their lengths reveal slant and lens distortion.

A camera without roll, panned by p and pitched by q, sees the point (x, y) of the plane at the ray R (x, y, 1); rays are
bent to r (1 + k1 |r|^2). p, q, k1 and the focal length f minimise the variation in time of the logarithms of the links'
measured lengths, with prior knowledge,

    sum over links and frames of ((log l - mean of log l) / s)^2 + sum of (parameter / its spread)^2,

with s from the residuals themselves. The spreads are those of ordinary cameras. With a calibrated lens or plane they
are the uncertainty left by the boards. Its covariance (a sandwich over blocks of time) is the persistent part of the
angles' errors, which no scatter shows. A roll rotates all angles equally and is not observable: rows are assumed to be
level.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from fitting.films.calibration import Lens, Plane

#: Focal length of an ordinary camera [image widths].
USUAL_FOCUS = 1.25
#: Maximum values of pan [rad], pitch [rad], k1 and log(focus / usual).
LIMITS = np.array([0.6, 0.6, 0.6, 0.9])
#: Minimum noise of a circle's centre [pixel].
MIN_NOISE = 0.03
#: Standard deviation of normal numbers over the median of their absolute values.
MEDIAN_TO_DEVIATION = 1.4826
#: Duration of a block [s], over which deviations persist.
BLOCK_DURATION = 0.25


@dataclass(frozen=True)
class Flat:
    """From pixels of the video to the plane of motion, in pixels of a camera square to it: right, down.

    Attributes:
        size: (width, height) [pixel].
        lens: calibrated, or None.
        plane: from a board, or None.
        parameters: pan, pitch, k1 and log(focus / usual) (4,) applied after these, or None; covariance: theirs.
    """

    size: tuple[int, int]
    lens: Lens | None = None
    plane: Plane | None = None
    parameters: np.ndarray | None = None
    covariance: np.ndarray | None = None

    @property
    def middle(self) -> np.ndarray:
        """Intersection of the camera's axis with the picture (2,) [pixel]."""
        if self.lens is None:
            return (np.array(self.size) - 1) / 2
        return self.lens.centre

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Flat pixels (..., 2) of pixels of the video (..., 2)."""
        shape = np.shape(points)
        points = np.reshape(points, (-1, 2)).astype(float)
        if self.lens is not None:
            points = self.lens.straighten(points)
        if self.plane is not None:
            there = self.plane.to_metres(np.concatenate([self.middle[None], points]))
            points = (there[1:] - there[0]) * [1.0, -1.0] / self.plane.metres_per_pixel(self.middle) + self.middle
        if self.parameters is not None:
            points = self._tilt_points(points, self.parameters)
        return points.reshape(shape)

    def back(self, flat: np.ndarray) -> np.ndarray:
        """The inverse (Newton iteration with differences; the map is nearly the identity up to a shift)."""
        flat = np.asarray(flat, float)
        guess = np.broadcast_to(self.middle, flat.shape).copy()
        limit = 0.5 * np.array(self.size)
        for _ in range(12):
            slopes = central_differences(self, guess, 0.5)
            move = np.linalg.solve(slopes, (flat - self(guess))[..., None])[..., 0]
            guess = np.clip(guess + np.clip(move, -limit, limit), -limit, 3 * limit)
        return guess

    @property
    def spread(self) -> np.ndarray:
        """Prior spread of the parameters (4,)."""
        plane = self.plane is not None
        lens = self.lens is not None
        # pan and pitch [rad], k1, log(focal length): known from the boards, or not
        return np.where([plane, plane, lens, lens], 0.01, [0.15, 0.15, 0.15, 0.3])

    def _tilt_points(self, points: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Points (k, 2) of a camera with this pan, pitch, bending and focal length, as one square to the plane sees
        them."""
        pan, pitch, bending, focus = parameters
        usual = USUAL_FOCUS * self.size[0] if self.lens is None else self.lens.focus
        size = usual * np.exp(focus)
        ray = bent = (points - self.middle) / size
        for _ in range(6):  # bent = ray (1 + k1 |ray|^2)
            ray = bent / (1 + bending * np.sum(ray**2, axis=-1, keepdims=True))
        turn = rotation(pan, pitch)
        ahead = ray @ turn[:2] + turn[2]  # the inverse rotation of (ray, 1)
        return self.middle + size * ahead[:, :2] / ahead[:, 2:]


def rotation(pan: float, pitch: float) -> np.ndarray:
    """(3, 3) from right, down, away of the plane to those of a camera without roll."""
    cp, ct = np.cos([pan, pitch])
    sp, st = np.sin([pan, pitch])
    around = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    return np.array([[1.0, 0.0, 0.0], [0.0, ct, st], [0.0, -st, ct]]) @ around


def central_differences(f: Callable[[np.ndarray], np.ndarray], at: np.ndarray, step: float) -> np.ndarray:
    """Derivatives (..., n) of f by the n entries of the last axis of its argument."""
    return np.stack([f(at + d) - f(at - d) for d in step * np.eye(np.shape(at)[-1])], axis=-1) / (2 * step)


def flatten(pixels: np.ndarray, flat: Flat, fps: float) -> Flat:
    """The map that minimises the variation of the links' lengths.

    Args:
        pixels: (k, n, 2) of the video, NaN if not detected.
    """
    keep = np.flatnonzero(np.isfinite(link_lengths(pixels)).any(axis=1))
    keep = keep[spread_out(len(keep), 300)]
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

    size = np.nanmedian(lengths, axis=0)
    found = np.zeros(len(spread)) if flat.parameters is None else flat.parameters
    noise = 0.3 / size
    for _ in range(3):
        result = least_squares(
            lambda p, noise=noise: np.concatenate([(off(p) / noise).ravel(), p / spread]),
            np.clip(found, -0.9 * LIMITS, 0.9 * LIMITS),
            bounds=(-LIMITS, LIMITS),
            loss="soft_l1",
        )
        found = result.x
        left = np.where(both, np.abs(off(found)), np.nan)
        noise = np.maximum(MEDIAN_TO_DEVIATION * np.nanmedian(left, axis=0), MIN_NOISE / size)
        noise = np.where(np.isfinite(noise), noise, np.nanmedian(noise))
    return replace(flat, parameters=found, covariance=_covariance(off, found, noise, spread, keep, fps))


def spread_out(count: int, most: int) -> np.ndarray:
    """At most `most` of the numbers below `count`, spread evenly from the first to the last."""
    return np.unique(np.linspace(0, count - 1, most).astype(int))[:count]


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


def level_error(flat: Flat, others: list[Flat], pixels: np.ndarray) -> float:
    """Standard error [rad] of a rotation of the whole picture, which lengths do not show, by the jackknife.

    Args:
        others: the same map with the lens and plane from all pictures of the board but one, for each.
        pixels: (k, n, 2) of the video, NaN if not detected.
    """
    rows = pixels[spread_out(len(pixels), 20)]
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
