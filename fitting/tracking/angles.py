"""Angles of links from the nodes' places, in the thesis' four-quadrant convention, continuous in time.

With x to the left and y upwards, as the thesis counts from the lower right corner of the picture, its (7.1)-(7.4) are
the four quadrants of one function,

    theta_k = atan2(up, right),    (right, up) = node k + 1 less node k,

zero for a link that points right, positive counter-clockwise, in (-pi, pi]. The four cases leave out links along an
axis and jump by a full turn; `atan2` has the former, and the latter are taken out along time. In the words of the
traces contract: zero=horizontal, sign=-1, unit=rad (the simulator counts positive downwards).
"""

from __future__ import annotations

import numpy as np

from fitting.traces.trace import Convention, Trace

CONVENTION = Convention("horizontal", -1, "rad")
#: Fewest samples of a link that tell its scatter; least scatter [that of the edges]; passes that weigh anew.
FEWEST, LEAST, PASSES = 10, 0.3, 20


def four_quadrant(positions: np.ndarray) -> np.ndarray:
    """Angles (k, n - 1) [rad] of places (k, n, 2) (right, up), without jumps of a full turn; the first in (-pi, pi]."""
    link = np.diff(positions, axis=1)
    return np.unwrap(np.arctan2(link[..., 1], link[..., 0]), axis=0)


def angle_errors(positions: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Standard errors (k, n - 1) [rad] from those of the places (k, n), in one unit with them: across the link."""
    length = np.linalg.norm(np.diff(positions, axis=1), axis=-1)
    return np.sqrt(error[:, 1:] ** 2 + error[:, :-1] ** 2) / np.maximum(length, 1e-12)


def scatter(positions: np.ndarray, fit_error: np.ndarray, detected: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Standard errors (k, n - 1) [rad] of the angles from what is seen to be wrong with the lengths.

    What moves a node across its link moves it along the link as well, and there the truth is known: the length never
    changes. The scatter of each circle's edge, `fit_error` (k, n), is one part, v; the variance a of the other, the
    same for all samples of a link, is what the departures x of its length from its mean show beyond that,

        sum of (x^2 - v - a)/(v + a)^2 = 0.

    It holds all that comes and goes with place and direction: vibration, and what is left of lens and slant.

    Args:
        positions: (k, n, 2), in one unit with `fit_error`; seen: (k, n).
        used: (k, n - 1) samples that are to be trusted.
    """
    link = np.linalg.norm(np.diff(positions, axis=1), axis=-1)
    both = detected[:, 1:] & detected[:, :-1]
    expected = angle_errors(positions, np.where(detected, fit_error, 0.0))
    found = np.full(link.shape, np.nan)
    for j in range(link.shape[1]):
        good = both[:, j] & used[:, j]
        good = good if good.sum() >= FEWEST else both[:, j]
        if good.sum() < 2:
            found[:, j] = expected[:, j]
            continue
        variance, off = expected[good, j] ** 2, (link[good, j] / np.median(link[good, j]) - 1) ** 2
        more = float(np.mean(off))
        for _ in range(PASSES):
            weight = 1 / (variance + max(more, 0.0)) ** 2
            more = float(np.sum(weight * (off - variance)) / np.sum(weight))
        # edges that scatter more than the lengths do share pixels: the lengths are right
        scale = max(LEAST, float(np.sqrt(np.mean(np.minimum(off / variance, 1.0))))) if more < 0 else 1.0
        found[:, j] = np.sqrt((scale * expected[:, j]) ** 2 + max(more, 0.0))
    return np.where(both, found, np.nan)


def to_trace(name: str, t: np.ndarray, positions: np.ndarray, error: np.ndarray, valid: np.ndarray) -> Trace:
    """The trace of places (k, n, 2); samples that are not `valid` (k, n - 1) are empty, their `error` too.

    The bridged places keep the angle continuous across a gap, they are not passed on as measurements.
    """
    theta = np.where(valid, four_quadrant(positions), np.nan)
    return Trace(name, t, theta, se=np.where(valid, error, np.nan), convention=CONVENTION)
