"""Angles of links from the nodes' positions, in the thesis' four-quadrant convention, continuous in time.

With x to the left and y upwards, as the thesis counts from the lower right corner of the picture, its (7.1)-(7.4) are
the four quadrants of one function,

    theta_k = atan2(up, right),    (right, up) = node k + 1 minus node k,

zero for a link that points right, positive counter-clockwise, in (-pi, pi]. The four cases omit links along an axis and
jump by a full turn. `atan2` covers the former; the latter are removed along time. In the convention of traces this is
zero=horizontal, sign=-1, unit=rad (the simulator counts positive downwards).
"""

from __future__ import annotations

import numpy as np

from fitting.traces.trace import Convention, Trace
from fitting.tracking.flattening import link_lengths


def four_quadrant(positions: np.ndarray) -> np.ndarray:
    """Angles (k, n - 1) [rad] of positions (k, n, 2) (right, up), without jumps of a full turn; first in (-pi, pi]."""
    link = np.diff(positions, axis=1)
    return np.unwrap(np.arctan2(link[..., 1], link[..., 0]), axis=0)


def angle_errors(positions: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Standard errors (k, n - 1) [rad] from those of the positions (k, n), in the same unit: across the link."""
    length = np.linalg.norm(np.diff(positions, axis=1), axis=-1)
    return np.sqrt(error[:, 1:] ** 2 + error[:, :-1] ** 2) / np.maximum(length, 1e-12)


def scatter(positions: np.ndarray, fit_error: np.ndarray, detected: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Standard errors (k, n - 1) [rad] of the angles, estimated from the errors of the links' lengths.

    An error that moves a node across its link also moves it along the link, where the truth is known: the length is
    constant. One part of the variance is the scatter of each circle's edge, `fit_error` (k, n), squared: v. The other
    part, a, is the same for all samples of a link. It follows from the deviations x of its length from its mean,

        sum of (x^2 - v - a)/(v + a)^2 = 0.

    It contains all errors that vary with position and direction: vibration, and residual errors of lens and slant.

    Args:
        positions: (k, n, 2), in one unit with `fit_error`; seen: (k, n).
        used: (k, n - 1) valid samples.
    """
    link = np.linalg.norm(np.diff(positions, axis=1), axis=-1)
    both = detected[:, 1:] & detected[:, :-1]
    expected = angle_errors(positions, np.where(detected, fit_error, 0.0))
    found = np.full(link.shape, np.nan)
    for j in range(link.shape[1]):
        good = both[:, j] & used[:, j]
        # at least ten samples for the scatter of a link
        good = good if good.sum() >= 10 else both[:, j]
        if good.sum() < 2:
            found[:, j] = expected[:, j]
            continue
        variance, off = expected[good, j] ** 2, (link[good, j] / np.median(link[good, j]) - 1) ** 2
        more = float(np.mean(off))
        for _ in range(20):
            weight = 1 / (variance + max(more, 0.0)) ** 2
            more = float(np.sum(weight * (off - variance)) / np.sum(weight))
        # edges that scatter more than the lengths share pixels: the lengths are right
        scale = max(0.3, float(np.sqrt(np.mean(np.minimum(off / variance, 1.0))))) if more < 0 else 1.0
        found[:, j] = np.sqrt((scale * expected[:, j]) ** 2 + max(more, 0.0))
    return np.where(both, found, np.nan)


def to_trace(name: str, t: np.ndarray, positions: np.ndarray, error: np.ndarray, valid: np.ndarray) -> Trace:
    """The trace of positions (k, n, 2); samples that are not `valid` (k, n - 1) are empty, and so is their `error`.

    The bridged positions keep the angle continuous across a gap; they are not passed on as measurements.
    """
    theta = np.where(valid, four_quadrant(positions), np.nan)
    return Trace(name, t, theta, se=np.where(valid, error, np.nan), convention=Convention("horizontal", -1, "rad"))


# Motion out of the plane, detected from links that seem to shorten in a way that no fixed camera explains.
#
# A link that swings out of the plane by psi is seen with cos psi of its length. A slanting camera or a bending lens
# also shortens links, but always by the same amount at the same position and direction:
#
#     log l = a + (1, x, z) (b cos 2 theta + c sin 2 theta) + (x, z, x^2, x z, z^2) d + rest,
#
# where theta is the link's angle and (x, z) its middle. The part of the rest that persists from frame to frame cannot
# be noise of the marks: it is motion out of the plane.

#: Relative standard deviation of a link's length that is reported as motion out of the plane: a swing of 0.1 rad.
OUT_OF_PLANE = 0.003


def changing_lengths(flat: np.ndarray, used: np.ndarray) -> tuple[str, ...]:
    """A line if links change their lengths, which rigid ones in the plane of motion do not.

    Args:
        flat: positions (k, n, 2) in the plane of motion, in any unit.
        used: (k, n - 1), frames in which a link is detected.
    """
    away = out_of_plane(flat, used)
    worst = int(np.argmax(away))
    if away[worst] > OUT_OF_PLANE:
        return (
            f"motion out of the plane: link {worst + 1} seems to change its length by {100 * away[worst]:.2g} %, which "
            "a fixed camera cannot show for a motion in the plane",
        )
    length = np.where(used, link_lengths(flat), np.nan)
    known = [column[np.isfinite(column)] for column in length.T]
    change = np.array([np.std(column) / np.mean(column) if len(column) else 0.0 for column in known])
    worst = int(np.argmax(change))
    if change[worst] > 0.03:
        return (
            f"link {worst + 1} changes its length by {100 * change[worst]:.2g} %: motion out of the plane, a slanting "
            "camera (--plane) or an uncalibrated lens (--calibration)",
        )
    return ()


def out_of_plane(flat: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Relative standard deviation of the links' lengths (n - 1,) due to motion out of the plane."""
    # minimum number of pairs of frames from which motion out of the plane is detected
    fewest_pairs = 30
    length, middle = link_lengths(flat), 0.5 * (flat[:, 1:] + flat[:, :-1])
    along = np.diff(flat, axis=1)
    twice = 2 * np.arctan2(along[..., 1], along[..., 0])
    found = np.zeros(length.shape[1])
    for j in range(len(found)):
        keep = used[:, j] & (length[:, j] > 0)
        if keep.sum() < fewest_pairs:
            continue
        position = middle[keep, j] - middle[keep, j].mean(axis=0)
        x, z = (position / max(np.abs(position).max(), 1e-300)).T
        c, s, one = np.cos(twice[keep, j]), np.sin(twice[keep, j]), np.ones_like(x)
        terms = [one, x, z, x * x, x * z, z * z, *(f * g for f in (one, x, z) for g in (c, s))]
        columns = np.stack(terms, axis=1)
        log_length = np.log(length[keep, j])
        rest = np.full(len(keep), np.nan)
        rest[keep] = log_length - columns @ np.linalg.lstsq(columns, log_length, rcond=None)[0]
        pairs = rest[1:] * rest[:-1]
        pairs = pairs[np.isfinite(pairs)]
        if len(pairs) >= fewest_pairs:
            found[j] = np.sqrt(max(float(pairs.mean()), 0.0))
    return found
