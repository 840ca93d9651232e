"""The motion of links that the columns of a file show."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class LinkMotion(NamedTuple):
    """Angles of links over time. If the file has points, also the lengths and the pivot that they show.

    Attributes:
        t: (k,) in the file's unit.
        theta: angles (k, n) [rad] without jumps. Angles of points are measured from straight down, in the sense of
            rotation from the file's x to its y axis.
        notes: how they were read.
        joint: complex (k,), start of the last link relative to the pivot [file's unit of length]; the real part points
            down. None if the file has angles.
        lengths: (n,), lengths of the links [file's unit of length]; NaN for a last link of unknown length. None if the
            file has angles.
        pivot_error: (2,), standard errors of the pivot, sideways and up, over the length of the first link. None if the
            file has angles, or points that show the pivot.
    """

    t: np.ndarray
    theta: np.ndarray
    notes: tuple[str, ...]
    joint: np.ndarray | None = None
    lengths: np.ndarray | None = None
    pivot_error: np.ndarray | None = None
