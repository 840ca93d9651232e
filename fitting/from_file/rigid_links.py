"""Rigid links in a film: their directions, the points that move with them, and the joint of two.

A point of the film is a complex number p, whose noise in each coordinate has the standard deviation sigma. A joint of
two links, with origins o_1, o_2 and directions e_1, e_2 (of size 1) in each frame, lies at constants w of both,

    o_1 + w_1 e_1 = o_2 + w_2 e_2,

which is linear in w.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fitting.traces.noise import NORMAL_MEDIAN

#: Change of a distance, in its noise, up to which a link keeps it; relative change that a lens may cause.
RIGID_CHANGE = 3.0
LENS_DISTORTION = 0.001
#: Difference of two directions of one rigid link, in their noise, and in addition as a fraction of their motion.
NOISE_TOLERANCE = 1.5
SAME_DIRECTION = 0.01
#: Variance of a fourth difference of white noise, over that of the noise: 1 + 16 + 36 + 16 + 1.
FOURTH_DIFFERENCE_VARIANCE = 70
#: Quantile of the deviations that stands for the spread: two links may swing alike most of the time.
SPREAD_QUANTILE = 0.95
#: Standard deviations of that quantile, of one coordinate and of the distance in the plane.
SPREAD_DEVIATIONS = 1.96
PLANE_DEVIATIONS = 2.45


@dataclass(frozen=True)
class Body:
    """A rigid link.

    Attributes:
        origin: a point that moves with it (k,).
        arm: from the two points that give its direction (k,).
        end: its last point (k,).
        pair: whether its direction is that of two points on it.
    """

    origin: np.ndarray
    arm: np.ndarray
    end: np.ndarray
    pair: bool = False

    @cached_property
    def direction(self) -> np.ndarray:
        """(k,), of size 1."""
        return directions_of(self.arm)


def with_point(body: Body, point: np.ndarray, start: np.ndarray) -> Body:
    """A body that starts at `start`, with a further point (k,) on it."""
    if np.nanmedian(np.abs(point - start)) <= np.nanmedian(np.abs(body.end - start)):
        return body
    if body.pair:
        return replace(body, end=point)
    # a longer arm gives a better direction
    return Body(point, point - start, point)


def directions_of(reach: np.ndarray) -> np.ndarray:
    """Directions of size 1 of complex numbers; NaN where the film misses a point, or two points coincide."""
    size = np.abs(reach)
    direction = np.full_like(reach, np.nan)
    # a complex number over NaN would raise a warning
    return np.divide(reach, size, out=direction, where=size > 0)


def noise_of(p: np.ndarray) -> float:
    """Standard deviation of a coordinate of a point (k,), from fourth differences."""
    part = np.stack([p.real, p.imag])
    typical = float(np.nanmedian(np.abs(np.diff(part, 4, axis=1))))
    return typical / (NORMAL_MEDIAN * np.sqrt(FOURTH_DIFFERENCE_VARIANCE))


def distance_change(one: np.ndarray, other: np.ndarray, sigma: float) -> float:
    """Change of the distance of two points in units of its noise."""
    size = np.abs(one - other)
    typical = float(np.nanmedian(size))
    if not typical > 0:
        return np.inf
    return spread_of(size - typical) / (np.sqrt(2) * sigma + LENS_DISTORTION * typical)


def spread_of(deviations: np.ndarray) -> float:
    """Standard deviation of deviations (k,) from zero, by most of them."""
    return float(np.nanquantile(np.abs(deviations), SPREAD_QUANTILE)) / SPREAD_DEVIATIONS


def turns_with(link: np.ndarray, body: Body, sigma: float) -> bool:
    """Whether a direction (k,) turns with a body."""
    apart = np.angle(directions_of(link) * body.direction.conj())
    apart = np.angle(np.exp(1j * (apart - np.angle(np.nanmean(np.exp(1j * apart))))))
    own = np.angle(body.direction / np.nanmean(body.direction))
    noise = np.sqrt(2) * sigma * np.hypot(1 / np.nanmedian(np.abs(link)), 1 / np.nanmedian(np.abs(body.arm)))
    return spread_of(apart) < NOISE_TOLERANCE * noise + SAME_DIRECTION * float(np.nanstd(own))


def joint_of(one: Body, other: Body, sigma: float) -> tuple[np.ndarray, float]:
    """Joint (k,) of two links, and its error in units of the noise."""
    basis = np.stack([other.direction, -one.direction], axis=1)
    apart = one.origin - other.origin
    known = np.isfinite(apart) & np.isfinite(basis).all(axis=1)
    basis = basis[known]
    apart = apart[known]
    shift, own = np.linalg.lstsq(basis, apart, rcond=None)[0]
    left = float(np.quantile(np.abs(basis @ [shift, own] - apart), SPREAD_QUANTILE))
    # the noise of the points extrapolated along both links
    levers = np.abs([own, shift]) / np.nanmedian(np.abs([one.arm, other.arm]), axis=1)
    grown = np.sqrt(np.sum((1.0 + levers) ** 2 + levers**2))
    expected = PLANE_DEVIATIONS * sigma * grown + LENS_DISTORTION * float(np.median(np.abs(apart)))
    joint = 0.5 * (one.origin + own * one.direction + other.origin + shift * other.direction)
    return joint, left / expected
