"""Points of a film or a tracker as angles of links: the pivot, the joints and the lengths that they show.

A point of the film is a complex number p. Points on one rigid link keep their distances. A joint of two links, with
origins o_1, o_2 and directions e_1, e_2 (of size 1) in each frame, lies at constants w of both,

    o_1 + w_1 e_1 = o_2 + w_2 e_2,        and the pivot c at   o_1 + w_1 e_1 = c,

which are linear in w and c.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, permutations
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from dropper_jax.base.errors import SceneError
from fitting.from_file.motion import LinkMotion
from fitting.traces.trace import unwrap

#: Movement of a fixed point as a fraction of the fastest point's.
FIXED_SPREAD = 0.03
#: Change of a distance, in its noise, up to which a link keeps it; relative change that a lens may cause; change of a
#: good chain.
RIGID_CHANGE = 3.0
LENS_DISTORTION = 0.001
GOOD_CHANGE = 1.5
#: Difference of two directions of one rigid link, as a fraction of their motion, beyond their noise.
SAME_DIRECTION = 0.01
#: Maximum number of points whose order is tried.
MOST_POINTS = 5
#: Parts of the rows without which the pivot is found again, and how often each part comes.
JACKKNIFE_PARTS = 10
PART_REPEATS = 20
#: Maximum distance of a pivot over the extent of the points. A link as long as this that swings by 0.6 degrees moves by
#: its extent. From farther away, the tolerance of a lens (`LENS_DISTORTION`) exceeds half of it: any motion fits.
FARTHEST_PIVOT = 100.0


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


class Chain(NamedTuple):
    """Bodies from the pivot on, the start (k,) of each, and the largest change of a distance in its noise."""

    bodies: list[Body]
    pivot: complex
    joints: list[np.ndarray]
    worst: float


def read_points(file: str, t: np.ndarray, points: np.ndarray) -> LinkMotion:
    """The motion of the links that points (m, k) belong to, as complex numbers.

    Raises:
        SceneError: points that belong to no chain.
    """
    spread = np.array([np.nanstd(p) for p in points])
    if not spread.max() > 0:
        raise SceneError(f"{file}: the points do not move. Give a file with motion")
    notes = []
    fixed = spread < FIXED_SPREAD * spread.max()
    pivot = None
    if fixed.sum() == 1:
        pivot = complex(np.nanmean(points[fixed][0]))
        notes.append("the point that does not move is the pivot")
    chain, order = find_chain(file, points[~fixed], pivot)
    if order != tuple(range(len(order))):
        notes.append(f"order of the points from the pivot on: {', '.join(str(i + 1) for i in order)}")
    notes.append(f"pivot at ({chain.pivot.real:.4g}, {chain.pivot.imag:.4g})")
    reaches, lengths = links_of(chain)
    theta = unwrap(np.angle(directions_of(reaches)))
    down = resting_direction(theta)
    theta -= down + 2 * np.pi * np.round((np.nanmedian(theta, axis=0) - down) / (2 * np.pi))  # each link hangs at rest
    joint = (chain.joints[-1] - chain.pivot) * np.exp(-1j * down)
    pivot_error = None
    if pivot is None:
        moving = points[~fixed][list(order)]
        pivot_error = error_of_pivot(moving, down) / np.nanmedian(np.abs(reaches[:, 0]))
    return LinkMotion(t, theta, tuple(notes), joint, lengths, pivot_error)


def find_chain(file: str, points: np.ndarray, pivot: complex | None) -> tuple[Chain, tuple[int, ...]]:
    """The chain that points (m, k) fit best, and their order in it; the order of the file is tried first.

    Raises:
        SceneError: they fit none.
    """
    in_order = tuple(range(len(points)))
    orders = [in_order]
    if len(points) <= MOST_POINTS:
        orders = permutations(in_order)
    sigma = float(np.median([noise_of(point) for point in points]))
    best = None
    best_order = in_order
    for order in orders:
        chain = chain_of([points[i] for i in order], pivot, sigma)
        if chain is not None and (best is None or chain.worst < best.worst):
            best = chain
            best_order = order
        if best is not None and order == in_order and best.worst < GOOD_CHANGE:
            break
    if best is None:
        raise SceneError(
            f"{file}: the points keep no distance to a pivot or to one another. Give the points of a chain from its "
            "pivot on, or name the columns: --columns time=t,x_1=...,y_1=..."
        )
    return best, best_order


def links_of(chain: Chain) -> tuple[np.ndarray, np.ndarray]:
    """Vectors of the links (k, n) and their lengths (n,); NaN for a last link of which only two points are known."""
    last = chain.bodies[-1]
    reaches = [after - before for before, after in pairwise(chain.joints)]
    if last.pair:
        reaches.append(last.arm)
    else:
        reaches.append(last.end - chain.joints[-1])
    lengths = np.nanmedian(np.abs(reaches), axis=1)
    if last.pair:
        lengths[-1] = np.nan
    return np.transpose(reaches), lengths


def chain_of(points: list[np.ndarray], pivot: complex | None, sigma: float) -> Chain | None:
    """The chain of points in this order; None if they do not fit.

    Args:
        pivot: None: found from the first points.
        sigma: noise of a coordinate.
    """
    first = points[0]
    rest = points[1:]
    in_pairs = pivot is None and len(points) % 2 == 0
    if pivot is None:
        pivot = pivot_of(first, rest, sigma)
        if is_far(pivot, points):
            return None
    start = np.full(len(first), pivot)
    worst = rigid(first, start, sigma)
    if worst > RIGID_CHANGE:
        return None
    joints = [start]
    bodies = [Body(first, first - pivot, first)]
    own = [first]  # points of the last body
    while rest:
        point = rest.pop(0)
        body = bodies[-1]
        start = joints[-1]
        if rigid(point, body.origin, sigma) < RIGID_CHANGE and turns_with(point - body.origin, body, sigma):
            own.append(point)
            bodies[-1] = with_point(body, point, start)
            continue
        joint = min(own, key=lambda p: rigid(point, p, sigma))
        by_hook = rigid(point, joint, sigma)
        by_pair = np.inf
        new = Body(point, point - joint, point)
        if rest and rigid(point, rest[0], sigma) < RIGID_CHANGE:
            pair = Body(point, rest[0] - point, rest[0], pair=True)
            pair_joint, by_pair = joint_of(body, pair, sigma)
        nearest = min(by_hook, by_pair)
        if nearest > RIGID_CHANGE:
            return None
        worst = max(worst, nearest)
        own = [point]
        # of points in pairs, the joint of two is their own point only by chance
        if by_pair < by_hook or (in_pairs and by_pair < GOOD_CHANGE):
            joint = pair_joint
            new = pair
            own.append(rest.pop(0))
        joints.append(joint)
        bodies.append(new)
    return Chain(bodies, pivot, joints, worst)


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
    return 1.4826 * float(np.nanmedian(np.abs(np.diff(part, 4, axis=1)))) / np.sqrt(70)


#: Quantile of the deviations that stands for the spread: two links may swing alike most of the time.
SPREAD_QUANTILE = 0.95
#: Standard deviations of that quantile.
SPREAD_DEVIATIONS = 1.96


def rigid(one: np.ndarray, other: np.ndarray, sigma: float) -> float:
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
    return spread_of(apart) < 1.5 * noise + SAME_DIRECTION * float(np.nanstd(own))


def centre_of(p: np.ndarray) -> complex:
    """Centre of the circle through points (k,)."""
    p = p[np.isfinite(p)]
    p = p[:: max(1, len(p) // 4000)]
    middle = p.mean()
    size = np.std(p)
    p = (p - middle) / size
    basis = np.stack([2 * p.real, 2 * p.imag, np.ones(len(p))], axis=1)
    a, b, c = np.linalg.lstsq(basis, np.abs(p) ** 2, rcond=None)[0]
    start = [a, b, np.sqrt(max(c + a**2 + b**2, 1e-12))]
    found = least_squares(lambda v: np.abs(p - complex(*v[:2])) - v[2], start, loss="soft_l1", f_scale=0.05).x
    return complex(middle + size * complex(*found[:2]))


def pivot_of(first: np.ndarray, others: Iterable[np.ndarray], sigma: float) -> complex:
    """Pivot of the first link: by two of its points if another one is on it, otherwise the centre of its circle."""
    centre = centre_of(first)
    for other in others:
        if rigid(first, other, sigma) < RIGID_CHANGE:
            return pivot_of_pair(first, other, centre, sigma)
    return centre


def error_of_pivot(points: np.ndarray, down: float) -> np.ndarray:
    """Standard errors (2,) of the pivot that points (m, k) show, sideways and along the direction down [rad].

    By the jackknife: found again without each of `JACKKNIFE_PARTS` parts of the rows, which alternate through the file.
    """
    sigma = float(np.median([noise_of(point) for point in points]))
    rows = np.arange(points.shape[1])
    part = rows * JACKKNIFE_PARTS * PART_REPEATS // len(rows) % JACKKNIFE_PARTS
    found = np.array([pivot_of(*_without(points, part == i), sigma) for i in range(JACKKNIFE_PARTS)])
    apart = (found - found.mean()) * np.exp(-1j * down)
    return np.sqrt((JACKKNIFE_PARTS - 1) * np.mean([apart.imag**2, apart.real**2], axis=1))


def _without(points: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first point (k,) and the others (m - 1, k), unknown in some rows."""
    left = np.where(rows, np.nan, points)
    return left[0], left[1:]


def is_far(pivot: complex, points: Sequence[np.ndarray]) -> bool:
    """Whether a pivot is too far from points (m, k) to follow from their motion."""
    middle = np.nanmean(points)
    extent = np.nanquantile(np.abs(np.subtract(points, middle)), SPREAD_QUANTILE)
    return bool(np.abs(pivot - middle) > FARTHEST_PIVOT * extent)


def pivot_of_pair(one: np.ndarray, other: np.ndarray, near: complex, sigma: float) -> complex:
    """Pivot c of a link with two points: `one + w e = c`; the centre near them where they do not turn about it."""
    direction = directions_of(other - one)
    if not turns_with(other - one, Body(one, one - near, one), sigma):
        return near
    known = np.isfinite(direction) & np.isfinite(one)
    basis = np.stack([np.ones(known.sum()), -direction[known]], axis=1)
    return complex(np.linalg.lstsq(basis, one[known], rcond=None)[0][0])


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
    expected = 2.45 * sigma * grown + LENS_DISTORTION * float(np.median(np.abs(apart)))
    joint = 0.5 * (one.origin + own * one.direction + other.origin + shift * other.direction)
    return joint, left / expected


def resting_direction(theta: np.ndarray) -> float:
    """Direction about which the links (k, n) swing in the last third [rad]."""
    late = theta[2 * len(theta) // 3 :]
    return float(np.angle(np.nanmean(np.exp(1j * late))))
