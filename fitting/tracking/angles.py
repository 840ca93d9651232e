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

from fitting.traces.trace import Convention, Trace, noise

CONVENTION = Convention("horizontal", -1, "rad")


def four_quadrant(places: np.ndarray) -> np.ndarray:
    """Angles (k, n - 1) [rad] of places (k, n, 2) (right, up), without jumps of a full turn; the first in (-pi, pi]."""
    link = np.diff(places, axis=1)
    return np.unwrap(np.arctan2(link[..., 1], link[..., 0]), axis=0)


def angle_errors(places: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Standard errors (k, n - 1) [rad] from those of the places (k, n), in one unit with them: across the link."""
    length = np.linalg.norm(np.diff(places, axis=1), axis=-1)
    return np.sqrt(error[:, 1:] ** 2 + error[:, :-1] ** 2) / np.maximum(length, 1e-12)


def place_errors(t: np.ndarray, places: np.ndarray, fit_error: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Standard errors (k, n) of the places, from two sides.

    The scatter of the edge points gives each sample's weight against the others, `fit_error` (k, n); the size of the
    noise comes from differences of high order along time (`traces.noise`), which also sees what moves a whole circle.
    Where the motion itself shows in these differences the error is too large, never too small; errors that stay for
    long, such as a lens that was not calibrated, do not show in it.
    """
    found = np.full(fit_error.shape, np.nan)
    for node in range(places.shape[1]):
        column = np.where(seen[:, node, None], places[:, node], np.nan)
        typical = float(np.nanmedian(np.where(seen[:, node], fit_error[:, node], np.nan)))
        scatter = float(np.hypot(*noise(Trace("node", t, column)))) / np.sqrt(2)
        found[:, node] = np.maximum(scatter, typical) * np.maximum(1.0, fit_error[:, node] / typical)
    return np.where(seen, found, np.nan)


def to_trace(name: str, t: np.ndarray, places: np.ndarray, error: np.ndarray, seen: np.ndarray) -> Trace:
    """The trace of places (k, n, 2) [m]; a link one of whose markers was not seen has an empty sample and error.

    The bridged places keep the angle continuous across a gap, they are not passed on as measurements.
    """
    both = seen[:, 1:] & seen[:, :-1]
    theta = np.where(both, four_quadrant(places), np.nan)
    return Trace(name, t, theta, se=np.where(both, angle_errors(places, error), np.nan), convention=CONVENTION)
