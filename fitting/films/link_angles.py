"""Angles of links from the nodes' positions, in the thesis' four-quadrant convention, continuous in time.

With x to the left and y upwards, as the thesis counts from the lower right corner of the picture, its (7.1)-(7.4)
are the four quadrants of one function,

    theta_k = atan2(up, right),    (right, up) = node k + 1 minus node k,

zero for a link that points right, positive counter-clockwise, in (-pi, pi]. The four cases omit links along an axis
and jump by a full turn. `atan2` covers the former; the latter are removed along time. In the convention of traces
this is zero=horizontal, sign=-1, unit=rad (the simulator counts positive downwards).
"""

from __future__ import annotations

import numpy as np

from fitting.films.lengths import link_lengths
from fitting.traces.trace import Convention, Trace

#: Minimum number of valid samples of a link that show its scatter; with fewer, all detected samples are used.
MIN_VALID = 10
#: Number of iterations for the further variance of a link.
ITERATIONS = 20
#: Minimum factor on the errors of edges that scatter more than the lengths.
SMALLEST_SCALE = 0.3


def four_quadrant(positions: np.ndarray) -> np.ndarray:
    """Angles (k, n - 1) [rad] of positions (k, n, 2) (right, up), without jumps of a full turn; first in (-pi, pi]."""
    link = np.diff(positions, axis=1)
    return np.unwrap(np.arctan2(link[..., 1], link[..., 0]), axis=0)


def angle_errors(positions: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Standard errors (k, n - 1) [rad] from those of the positions (k, n), in the same unit: across the link."""
    return np.sqrt(error[:, 1:] ** 2 + error[:, :-1] ** 2) / np.maximum(link_lengths(positions), 1e-12)


def estimate_angle_errors(positions: np.ndarray, fit_error: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Standard errors (k, n - 1) [rad] of the angles, estimated from the errors of the links' lengths.

    An error that moves a node across its link also moves it along the link, where the truth is known: the length is
    constant. One part of the variance is the scatter of each circle's edge, `fit_error` (k, n), squared: v. The other
    part, a, is the same for all samples of a link. It follows from the deviations x of its length from its mean,

        sum of (x^2 - v - a)/(v + a)^2 = 0.

    It contains all errors that vary with position and direction: vibration, and residual errors of lens and slant.

    Args:
        positions: (k, n, 2), in one unit with `fit_error`, NaN if not detected.
        used: (k, n - 1) valid samples.
    """
    length = link_lengths(positions)
    errors = angle_errors(positions, fit_error)
    for link in range(length.shape[1]):
        detected = np.isfinite(length[:, link])
        good = detected & used[:, link]
        if good.sum() < MIN_VALID:
            good = detected
        if good.sum() < 2:
            continue
        variance = errors[good, link] ** 2
        good_length = length[good, link]
        off = (good_length / np.median(good_length) - 1) ** 2
        excess = _excess_variance(off, variance)
        scale = 1.0
        if excess < 0:  # edges that scatter more than the lengths share pixels: the lengths are right
            scale = max(SMALLEST_SCALE, np.sqrt(np.mean(np.minimum(off / variance, 1.0))))
        errors[:, link] = np.sqrt((scale * errors[:, link]) ** 2 + max(excess, 0.0))
    return errors


def _excess_variance(off: np.ndarray, variance: np.ndarray) -> float:
    """a of the squared deviations x^2 (m,) of a length and the variances v (m,): zero of `sum (x^2 - v - a)/(v + a)^2`.

    By iteration with the weights of the last a; negative if the lengths scatter less than v.
    """
    excess = np.mean(off)
    for _ in range(ITERATIONS):
        weight = 1 / (variance + max(excess, 0.0)) ** 2
        excess = np.sum(weight * (off - variance)) / np.sum(weight)
    return excess


def to_trace(name: str, t: np.ndarray, positions: np.ndarray, error: np.ndarray, valid: np.ndarray) -> Trace:
    """The trace of positions (k, n, 2); samples that are not `valid` (k, n - 1) are empty, and so is their `error`.

    The bridged positions keep the angle continuous across a gap; they are not passed on as measurements.
    """
    theta = np.where(valid, four_quadrant(positions), np.nan)
    return Trace(name, t, theta, se=np.where(valid, error, np.nan), convention=Convention("horizontal", -1, "rad"))
