"""Points of a film or a tracker as angles of links: the pivot, the joints and the lengths that they show.

A point of the film is a complex number p. Points on one rigid link keep their distances. A joint of two links, with
origins o_1, o_2 and directions e_1, e_2 (of size 1) in each frame, lies at constants w of both,

    o_1 + w_1 e_1 = o_2 + w_2 e_2,        and the pivot c at   o_1 + w_1 e_1 = c,

which are linear in w and c.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from scipy.optimize import least_squares

from dropper_jax.base.errors import SceneError
from fitting.traces.trace import unwrap

#: Movement of a fixed point as a fraction of the fastest point's.
FIXED = 0.03
#: Change of a distance that a link keeps, in its noise; relative change that a lens may cause; change of a good chain.
KEPT = 3.0
LENS = 0.001
GOOD = 1.5
#: Difference of two directions of one rigid link, as a fraction of their motion, beyond their noise.
SAME_LINK = 0.01
#: Most points whose order is tried.
MOST_POINTS = 5


@dataclass(frozen=True)
class Links:
    """Angles of links from straight down, and what the points show of their lengths.

    Attributes:
        theta: (k, n) [rad], in the sense of rotation from the file's x to its y axis.
        joint: (k,) start of the last link from the pivot in the file's unit of length; its real part points down.
        lengths: distances of joints (n,) in the file's unit of length; NaN for a last link of unknown length.
        notes: how they were found.
    """

    theta: np.ndarray
    joint: np.ndarray
    lengths: np.ndarray
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Body:
    """A rigid link.

    Attributes:
        origin: a point that moves with it (k,).
        direction: (k,), of size 1.
        arm: from the two points that give it (k,).
        end: its last point (k,).
        pair: whether its direction is that of two points on it.
    """

    origin: np.ndarray
    direction: np.ndarray
    arm: np.ndarray
    end: np.ndarray
    pair: bool


def read_points(file: str, points: np.ndarray) -> Links:
    """Angles of the links that points (m, k) belong to, as complex numbers.

    Raises:
        SceneError: points that belong to no chain.
    """
    spread = np.array([float(np.nanstd(p)) for p in points])
    if not spread.max() > 0:
        raise SceneError(f"{file}: the points do not move. Give a file with motion")
    notes = []
    fixed = spread < FIXED * spread.max()
    pivot = None
    if fixed.sum() == 1:
        pivot = complex(np.nanmean(points[fixed][0]))
        notes.append("the point that does not move is the pivot")
    moving = list(points[~fixed])
    orders = [tuple(range(len(moving)))]
    if len(moving) <= MOST_POINTS:
        orders = list(permutations(range(len(moving))))
    chains = []
    sigma = float(np.median([noise_of(point) for point in moving]))
    for order in orders:
        found = chain_of([moving[i] for i in order], pivot, sigma)
        if found is not None:
            chains.append((found[2], order, found))
        if chains and order == orders[0] and chains[0][0] < GOOD:
            break  # the order of the file fits
    if not chains:
        raise SceneError(
            f"{file}: the points keep no distance to a pivot or to one another. Give the points of a chain from its "
            "pivot on, or name the columns: --columns time=t,x_1=...,y_1=..."
        )
    _, order, (bodies, pivot, _, joints) = min(chains, key=lambda chain: chain[0])
    if order != orders[0]:
        notes.append(f"order of the points from the pivot on: {', '.join(str(i + 1) for i in order)}")
    directions = []
    lengths = []
    for j, body in enumerate(bodies):
        last = j + 1 == len(bodies)
        reach = body.end - joints[j] if last else joints[j + 1] - joints[j]
        ends_at_point = not last or not body.pair
        lengths.append(float(np.nanmedian(np.abs(reach))) if ends_at_point else np.nan)
        directions.append(unit(reach) if ends_at_point else body.direction)
    found = unwrap(np.angle(np.stack(directions, axis=1)))
    down = resting_direction(found)
    for j in range(found.shape[1]):  # each link hangs at rest
        found[:, j] -= down + 2 * np.pi * np.round(float(np.nanmedian(found[:, j]) - down) / (2 * np.pi))
    notes.append(f"pivot at ({pivot.real:.4g}, {pivot.imag:.4g})")
    joint = (joints[-1] - pivot) * np.exp(-1j * down)
    return Links(found, joint, np.array(lengths), tuple(notes))


def chain_of(
    points: list[np.ndarray], pivot: complex | None, sigma: float
) -> tuple[list[Body], complex, float, list[np.ndarray]] | None:
    """Bodies, pivot, largest change of a distance in its noise, and the start (k,) of every link, of points in this
    order; None if they do not fit.

    Args:
        sigma: noise of a coordinate.
    """
    first = points[0]
    rest = points[1:]
    pivot_found = pivot is None
    if pivot is None:
        pivot = centre_of(first)
        mates = [q for q in rest if rigid(first, q, sigma) < KEPT]
        better = None
        if mates:
            better = pivot_of_pair(first, mates[0], pivot, sigma)
        pivot = pivot if better is None else better
    worst = rigid(first, np.full(len(first), pivot), sigma)
    if worst > KEPT:
        return None
    joints = [np.full(len(first), pivot)]
    bodies = [Body(first, unit(first - pivot), first - pivot, first, False)]
    own = [first]  # points of the last body
    while rest:
        point = rest[0]
        rest = rest[1:]
        body = bodies[-1]
        if rigid(point, body.origin, sigma) < KEPT and turns_with(point - body.origin, body, sigma):
            own.append(point)
            farther = np.nanmedian(np.abs(point - joints[-1])) > np.nanmedian(np.abs(body.end - joints[-1]))
            if farther and body.pair:
                bodies[-1] = replace(body, end=point)
            elif farther:  # a longer arm gives a better direction
                bodies[-1] = Body(point, unit(point - joints[-1]), point - joints[-1], point, False)
            continue
        hook = min(own, key=lambda p: rigid(point, p, sigma))
        by_hook = rigid(point, hook, sigma)
        by_pair = np.inf
        joint = hook
        new = body
        if rest and rigid(point, rest[0], sigma) < KEPT:
            new = Body(point, unit(rest[0] - point), rest[0] - point, rest[0], True)
            joint, by_pair = joint_of(body, new, sigma)
        if min(by_hook, by_pair) > KEPT:
            return None
        worst = max(worst, min(by_hook, by_pair))
        # of points in pairs, the joint of two is their own point only by chance
        paired = pivot_found and len(points) % 2 == 0 and by_pair < GOOD
        if by_pair < by_hook or paired:
            joints.append(joint)
            bodies.append(new)
            own = [point, rest[0]]
            rest = rest[1:]
        else:
            joints.append(hook)
            bodies.append(Body(point, unit(point - hook), point - hook, point, False))
            own = [point]
    return bodies, pivot, worst, joints


def unit(reach: np.ndarray) -> np.ndarray:
    """Directions (k,) of size 1; NaN stays."""
    size = np.abs(reach)
    return np.where(size > 0, reach / np.where(size > 0, size, 1.0), np.nan)


def noise_of(p: np.ndarray) -> float:
    """Standard deviation of a coordinate of a point (k,), from fourth differences."""
    part = np.stack([p.real, p.imag])
    return 1.4826 * float(np.nanmedian(np.abs(np.diff(part, 4, axis=1)))) / np.sqrt(70)


#: Quantile of the deviations that stands for the spread: two links may swing alike most of the time.
MOST_ROWS = 0.95
#: Standard deviations of that quantile.
QUANTILE = 1.96


def rigid(one: np.ndarray, other: np.ndarray, sigma: float) -> float:
    """Change of the distance of two points in units of its noise."""
    size = np.abs(one - other)
    typical = float(np.nanmedian(size))
    if not typical > 0:
        return np.inf
    spread = float(np.nanquantile(np.abs(size - typical), MOST_ROWS)) / QUANTILE
    return spread / (np.sqrt(2) * sigma + LENS * typical)


def turns_with(link: np.ndarray, body: Body, sigma: float) -> bool:
    """Whether a direction (k,) turns with a body."""
    apart = np.angle(unit(link) * body.direction.conj())
    apart = np.angle(np.exp(1j * (apart - np.angle(np.nanmean(np.exp(1j * apart))))))
    own = np.angle(body.direction / np.nanmean(body.direction))
    noise = np.sqrt(2) * sigma * np.hypot(1 / np.nanmedian(np.abs(link)), 1 / np.nanmedian(np.abs(body.arm)))
    return float(np.nanquantile(np.abs(apart), 0.95)) / 1.96 < 1.5 * noise + SAME_LINK * float(np.nanstd(own))


def centre_of(p: np.ndarray) -> complex:
    """Centre of the circle through points (k,)."""
    p = p[np.isfinite(p)]
    p = p[:: max(1, len(p) // 4000)]
    middle = p.mean()
    size = float(np.std(p))
    x = ((p - middle) / size).real
    y = ((p - middle) / size).imag
    a, b, c = np.linalg.lstsq(np.stack([2 * x, 2 * y, np.ones(len(x))], axis=1), x**2 + y**2, rcond=None)[0]
    start = [a, b, np.sqrt(max(c + a**2 + b**2, 1e-12))]
    found = least_squares(lambda v: np.hypot(x - v[0], y - v[1]) - v[2], start, loss="soft_l1", f_scale=0.05).x
    return complex(middle + size * complex(found[0], found[1]))


def pivot_of_pair(one: np.ndarray, other: np.ndarray, near: complex, sigma: float) -> complex | None:
    """Pivot c of a link with two points: `one + w e = c`; None where they do not turn about the centre near them."""
    direction = unit(other - one)
    if not turns_with(other - one, Body(one, unit(one - near), one - near, one, False), sigma):
        return None
    known = np.isfinite(direction) & np.isfinite(one)
    basis = np.stack([np.ones(known.sum()), -direction[known]], axis=1)
    centre, _ = np.linalg.lstsq(basis, one[known], rcond=None)[0]
    return complex(centre)


def joint_of(one: Body, other: Body, sigma: float) -> tuple[np.ndarray, float]:
    """Joint (k,) of two links, and its error in units of the noise."""
    known = np.isfinite(one.origin) & np.isfinite(other.origin)
    known &= np.isfinite(one.direction) & np.isfinite(other.direction)
    basis = np.stack([other.direction[known], -one.direction[known]], axis=1)
    apart = (one.origin - other.origin)[known]
    shift, own = np.linalg.lstsq(basis, apart, rcond=None)[0]
    left = float(np.quantile(np.abs(basis @ np.array([shift, own]) - apart), 0.95))
    # the noise of the points extrapolated along both links
    levers = [abs(own) / float(np.nanmedian(np.abs(one.arm))), abs(shift) / float(np.nanmedian(np.abs(other.arm)))]
    grown = np.sqrt(sum((1.0 + lever) ** 2 + lever**2 for lever in levers))
    expected = 2.45 * sigma * grown + LENS * float(np.median(np.abs(apart)))
    joint = 0.5 * (one.origin + own * one.direction + other.origin + shift * other.direction)
    return joint, left / expected


def resting_direction(theta: np.ndarray) -> float:
    """Direction about which the links (k, n) swing in the last third [rad]."""
    late = theta[2 * len(theta) // 3 :]
    return float(np.angle(np.nanmean(np.exp(1j * late))))
