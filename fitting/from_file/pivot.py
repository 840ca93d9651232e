"""The pivot of a chain that points of a film do not show: where the first link turns.

Of a link with two points, with origin o and direction e (of size 1), the pivot is `c = o + w e` at a constant w; of one
point it is the centre of its circle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.optimize import least_squares

from fitting.from_file.rigid_links import (
    RIGID_CHANGE,
    SPREAD_QUANTILE,
    Body,
    directions_of,
    distance_change,
    noise_of,
    turns_with,
)

#: Number of points that a circle is fitted to: more take time and add little.
CIRCLE_POINTS = 4000
#: Distance of a point from the circle, over the spread of the points, from which it counts less.
CIRCLE_OUTLIER = 0.05
#: Parts of the rows without which the pivot is found again, and how often each part comes.
JACKKNIFE_PARTS = 10
PART_REPEATS = 20
#: Maximum distance of a pivot over the extent of the points. A link as long as this that swings by 0.6 degrees moves by
#: its extent. From farther away, the tolerance of a lens (`LENS_DISTORTION`) exceeds half of it: any motion fits.
FARTHEST_PIVOT = 100.0


def pivot_of(first: np.ndarray, others: Iterable[np.ndarray], sigma: float) -> complex:
    """Pivot of the first link: by two of its points if another one is on it, otherwise the centre of its circle."""
    centre = circle_centre(first)
    for other in others:
        if distance_change(first, other, sigma) < RIGID_CHANGE:
            return pivot_of_pair(first, other, centre, sigma)
    return centre


def pivot_of_pair(one: np.ndarray, other: np.ndarray, near: complex, sigma: float) -> complex:
    """Pivot c of a link with two points: `one + w e = c`; the centre near them where they do not turn about it."""
    direction = directions_of(other - one)
    if not turns_with(other - one, Body(one, one - near, one), sigma):
        return near
    known = np.isfinite(direction) & np.isfinite(one)
    basis = np.stack([np.ones(known.sum()), -direction[known]], axis=1)
    return complex(np.linalg.lstsq(basis, one[known], rcond=None)[0][0])


def circle_centre(p: np.ndarray) -> complex:
    """Centre of the circle through points (k,)."""
    p = p[np.isfinite(p)]
    p = p[:: max(1, len(p) // CIRCLE_POINTS)]
    middle = p.mean()
    size = np.std(p)
    p = (p - middle) / size
    basis = np.stack([2 * p.real, 2 * p.imag, np.ones(len(p))], axis=1)
    a, b, c = np.linalg.lstsq(basis, np.abs(p) ** 2, rcond=None)[0]
    start = [a, b, np.sqrt(max(c + a**2 + b**2, 1e-12))]
    found = least_squares(lambda v: np.abs(p - complex(*v[:2])) - v[2], start, loss="soft_l1", f_scale=CIRCLE_OUTLIER).x
    return complex(middle + size * complex(*found[:2]))


def is_far(pivot: complex, points: Sequence[np.ndarray]) -> bool:
    """Whether a pivot is too far from points (m, k) to follow from their motion."""
    middle = np.nanmean(points)
    extent = np.nanquantile(np.abs(np.subtract(points, middle)), SPREAD_QUANTILE)
    return bool(np.abs(pivot - middle) > FARTHEST_PIVOT * extent)


def error_of_pivot(points: np.ndarray, down: float) -> np.ndarray:
    """Standard errors (2,) of the pivot that points (m, k) show, sideways and along the direction down [rad].

    By the jackknife: found again without each of `JACKKNIFE_PARTS` parts of the rows, which alternate through the file.
    """
    sigma = float(np.median([noise_of(point) for point in points]))
    rows = np.arange(points.shape[1])
    part = rows * JACKKNIFE_PARTS * PART_REPEATS // len(rows) % JACKKNIFE_PARTS
    found = np.zeros(JACKKNIFE_PARTS, complex)
    for i in range(JACKKNIFE_PARTS):
        first, *others = np.where(part == i, np.nan, points)
        found[i] = pivot_of(first, others, sigma)
    apart = (found - found.mean()) * np.exp(-1j * down)
    return np.sqrt((JACKKNIFE_PARTS - 1) * np.mean([apart.imag**2, apart.real**2], axis=1))
