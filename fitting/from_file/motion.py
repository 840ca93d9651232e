"""The motion of links that the columns of a file show."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Motion(NamedTuple):
    """Angles of links; of points of a film also what they show of the lengths.

    Attributes:
        t: (k,) in the file's unit.
        theta: angles (k, n) [rad] without jumps; of points from straight down, in the sense of rotation from the file's
            x to its y axis.
        notes: how they were read.
        joint: of points, the start (k,) of the last link from the pivot in the file's unit of length; its real part
            points down.
        lengths: of points, distances of joints (n,) in the file's unit of length; NaN for a last link of unknown
            length.
        pivot_error: of points that show no pivot, standard errors of the one that is found (2,), sideways and up, over
            the length of the first link.
    """

    t: np.ndarray
    theta: np.ndarray
    notes: tuple[str, ...]
    joint: np.ndarray | None = None
    lengths: np.ndarray | None = None
    pivot_error: np.ndarray | None = None
