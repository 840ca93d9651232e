"""Points of a film or a tracker as angles of links: the pivot, the joints and the lengths that they show.

A point of the film is a complex number. Points on one rigid link keep their distances (see `rigid_links`).
"""

from __future__ import annotations

from itertools import pairwise, permutations
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.from_file.motion import LinkMotion
from fitting.from_file.pivot import error_of_pivot, is_far, pivot_of
from fitting.from_file.rigid_links import (
    RIGID_CHANGE,
    Body,
    directions_of,
    distance_change,
    joint_of,
    noise_of,
    turns_with,
    with_point,
)
from fitting.traces.trace import unwrap

#: Movement of a fixed point as a fraction of the fastest point's.
FIXED_SPREAD = 0.03
#: Change of a distance, in its noise, of a good chain.
GOOD_CHANGE = 1.5
#: Maximum number of points whose order is tried.
MOST_POINTS = 5


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
    orders = permutations(in_order) if len(points) <= MOST_POINTS else [in_order]
    sigma = float(np.median([noise_of(point) for point in points]))
    best = None
    best_order = in_order
    for order in orders:
        chain = build_chain([points[i] for i in order], pivot, sigma)
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


def build_chain(points: list[np.ndarray], pivot: complex | None, sigma: float) -> Chain | None:
    """The chain of points in this order; None if they do not fit.

    Args:
        pivot: None: found from the first points.
        sigma: noise of a coordinate.
    """
    first, *rest = points
    in_pairs = pivot is None and len(points) % 2 == 0
    if pivot is None:
        pivot = pivot_of(first, rest, sigma)
        if is_far(pivot, points):
            return None
    start = np.full(len(first), pivot)
    worst = distance_change(first, start, sigma)
    if worst > RIGID_CHANGE:
        return None
    joints = [start]
    bodies = [Body(first, first - pivot, first)]
    own = [first]  # points of the last body
    while rest:
        point = rest[0]
        body = bodies[-1]
        if distance_change(point, body.origin, sigma) < RIGID_CHANGE and turns_with(point - body.origin, body, sigma):
            own.append(rest.pop(0))
            bodies[-1] = with_point(body, point, joints[-1])
            continue
        joint, link, change = next_link(body, own, rest, sigma, in_pairs)
        if change > RIGID_CHANGE:
            return None
        worst = max(worst, change)
        joints.append(joint)
        bodies.append(link)
        own = [point]
        if link.pair:
            own.append(link.end)
        del rest[: len(own)]
    return Chain(bodies, pivot, joints, worst)


def next_link(
    body: Body, own: list[np.ndarray], rest: list[np.ndarray], sigma: float, in_pairs: bool
) -> tuple[np.ndarray, Body, float]:
    """Joint (k,) of a body and the link of the next point, that link, and the change of a distance in its noise.

    The joint is a point of the body, or follows from two points of the link.

    Args:
        own: points of the body.
        rest: the next points.
        in_pairs: whether every link has two points, so that the joint is one of them only by chance.
    """
    point = rest[0]
    joint = min(own, key=lambda p: distance_change(point, p, sigma))
    by_point = distance_change(point, joint, sigma)
    if len(rest) > 1 and distance_change(point, rest[1], sigma) < RIGID_CHANGE:
        pair = Body(point, rest[1] - point, rest[1], pair=True)
        pair_joint, by_pair = joint_of(body, pair, sigma)
        if by_pair < by_point or (in_pairs and by_pair < GOOD_CHANGE):
            return pair_joint, pair, min(by_point, by_pair)
    return joint, Body(point, point - joint, point), by_point


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


def resting_direction(theta: np.ndarray) -> float:
    """Direction about which the links (k, n) swing in the last third [rad]."""
    late = theta[2 * len(theta) // 3 :]
    return float(np.angle(np.nanmean(np.exp(1j * late))))
