"""Displacement of points and acceleration of nodes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import Record, arc
from dropper_jax.scene import WholeLine


def watch_circles(record: Record) -> list[Table]:
    """Per moving point: horizontal radius [m] about its mean position and, after a static start, its static position.

    With the ranges of x, y, z [m]. Fixed points are left out.
    """
    found = []
    buoys = {buoy.point: buoy.name for buoy in record.scene.buoys}
    for point in record.scene.points:
        path = record.point(point.name)
        if not point.is_free and np.ptp(path, axis=0).max() == 0.0:
            continue
        mean = path.mean(axis=0)
        about = np.hypot(*(path - mean)[:, :2].T)
        static = None
        from_static = None
        if record.static_start:
            static = record.solution.point_path(point.name)[0]
            from_static = float(np.hypot(*(path - static)[:, :2].T).max())
        found.append(
            {
                "point": point.name,
                "buoy": buoys.get(point.name),
                "mean_m": mean,
                "range_m": np.ptp(path, axis=0),
                "radius_max_m": float(about.max()),
                "radius_95_m": float(np.percentile(about, 95)),
                "static_m": static,
                "radius_from_static_max_m": from_static,
            }
        )
    return found


def accelerations(record: Record) -> list[Table]:
    """Per line: root mean square, 99th percentile and maximum acceleration [m/s^2] of its nodes, and its location.

    Central differences of the saved velocities, which do not resolve periods below two saved intervals.
    """
    size = record.acceleration
    found = []
    for where in record.written_lines:
        own = size[:, where.nodes]
        high = np.unravel_index(np.argmax(own), own.shape)
        found.append(
            {
                "line": where.name,
                "arc_length_m": node_arc(where.spec.length),
                "rms_m_per_s2": np.sqrt(np.mean(own**2, axis=0)),
                "p99_m_per_s2": np.percentile(own, 99, axis=0),
                "max_m_per_s2": own.max(axis=0),
                "largest_m_per_s2": float(own[high]),
                "at_m": float(node_arc(where.spec.length)[high[1]]),
                "t_s": float(record.t[high[0]]),
            }
        )
    return found


def node_arc(lengths: np.ndarray) -> np.ndarray:
    """Unstretched arc length (n + 1,) [m] of a line's nodes."""
    return np.concatenate([[0.0], np.cumsum(lengths)])


class Approach(NamedTuple):
    """The minimum distance of two lines [m], its sample, the other line, and the links of both."""

    distance: float
    sample: int
    other: int
    link: int
    other_link: int


def line_distances(record: Record) -> list[Table]:
    """Per line: the nearest line, the minimum distance of the axes [m], its time [s] and arc length along both [m].

    The distance is exact between straight links at the saved times (of a long record at 2000 of them). Links
    that end in a common point of both lines are left out.
    """
    lines = range(len(record.written_lines))
    nodes = [record.positions[:, line.nodes] for line in record.written_lines]
    low = np.stack([own.min(axis=(0, 1)) for own in nodes])
    high = np.stack([own.max(axis=(0, 1)) for own in nodes])
    gap = np.linalg.norm(np.maximum(np.maximum(low[:, None] - high, low - high[:, None]), 0.0), axis=-1)
    pairs = sorted((float(gap[a, b]), a, b) for a in lines for b in lines if a < b)
    best: dict[int, Approach] = {}
    for bound, a, b in pairs:
        # boxes at this distance cannot contain a closer pair than the present one
        if all(i in best and bound >= best[i].distance for i in (a, b)):
            continue
        near = _nearest(record, a, b)
        if near is None:
            continue
        if a not in best or near.distance < best[a].distance:
            best[a] = near
        if b not in best or near.distance < best[b].distance:
            best[b] = near._replace(other=a, link=near.other_link, other_link=near.link)
    return [_describe_distance(record, i, best.get(i)) for i in lines]


#: Number of evenly spaced instants: they are close enough that no approach of lines is missed.
INSTANTS = 2000


def looks_every(record: Record) -> int:
    """Samples between two instants."""
    return -(-len(record.t) // INSTANTS)


def _describe_distance(record: Record, index: int, near: Approach | None) -> Table:
    line = record.written_lines[index]
    if near is None:
        return {"line": line.name, "nearest": None, "least_distance_m": None}
    other = record.written_lines[near.other]
    return {
        "line": line.name,
        "nearest": other.name,
        "least_distance_m": near.distance,
        "t_s": float(record.t[near.sample]),
        "at_m": float(arc(line.spec.length)[near.link]),
        "nearest_at_m": float(arc(other.spec.length)[near.other_link]),
        "sampled_every_s": looks_every(record) * record.interval,
        "diameters_m": _touching(line, other),
    }


def _touching(line: WholeLine, other: WholeLine) -> float | None:
    """Half the sum of the maximum diameters [m], the distance of axes in contact; None if a line has no diameter."""
    own = line.spec.diameter
    next_to = other.spec.diameter
    if own is None or next_to is None:
        return None
    return float(0.5 * (np.max(own) + np.max(next_to)))


#: Pairs of links and instants that are compared at once: 1e6 need some tens of MB.
PAIRS_AT_ONCE = 100_000


def _nearest(record: Record, a: int, b: int) -> Approach | None:
    """The nearest approach of two lines over all samples; None if no links are compared."""
    i, j = _pairs(record.written_lines[a], record.written_lines[b])
    if not i.size:
        return None
    first = record.positions[:, record.written_lines[a].nodes]
    second = record.positions[:, record.written_lines[b].nodes]
    step = max(1, PAIRS_AT_ONCE // i.size)
    best = None
    looked = np.arange(0, len(record.t), looks_every(record))
    for k in range(0, len(looked), step):
        part = looked[k : k + step]
        p = first[part]
        q = second[part]
        distance = segment_distance(p[:, i], p[:, i + 1], q[:, j], q[:, j + 1])
        at = np.unravel_index(np.argmin(distance), distance.shape)
        if best is None or distance[at] < best.distance:
            best = Approach(float(distance[at]), int(part[at[0]]), b, int(i[at[1]]), int(j[at[1]]))
    return best


def _pairs(a: WholeLine, b: WholeLine) -> tuple[np.ndarray, np.ndarray]:
    """Compared links of both lines: all except those that end in a common point."""
    kept = []
    for mine, other in ((a, b), (b, a)):
        shared = set(other.stops.values())
        at = [node for node, point in mine.stops.items() if point in shared]
        kept.append(np.setdiff1d(np.arange(mine.spec.links), [*at, *(node - 1 for node in at)]))
    i, j = np.meshgrid(*kept, indexing="ij")
    return i.ravel(), j.ravel()


def segment_distance(p0: np.ndarray, p1: np.ndarray, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
    """Distance (...) [m] between the segments p0 p1 and q0 q1, ends (..., 3) [m].

    The nearest positions are both inside the segments, or one of them is an end. The result is the minimum of the
    common perpendicular, if its feet are inside, and of the four distances from an end to the other segment.
    """
    u = p1 - p0
    v = q1 - q0
    w = p0 - q0
    a = _dot(u, u)
    b = _dot(u, v)
    c = _dot(v, v)
    d = _dot(u, w)
    e = _dot(v, w)
    det = a * c - b * b
    crossed = det > 1e-12 * a * c
    s = np.where(crossed, b * e - c * d, -1.0) / np.where(crossed, det, 1.0)
    t = np.where(crossed, a * e - b * d, -1.0) / np.where(crossed, det, 1.0)
    inside = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    across = w + s[..., None] * u - t[..., None] * v
    ends = [_to_segment(p0, q0, v, c), _to_segment(p1, q0, v, c), _to_segment(q0, p0, u, a), _to_segment(q1, p0, u, a)]
    return np.sqrt(np.minimum.reduce([np.where(inside, _dot(across, across), np.inf), *ends]))


def _to_segment(position: np.ndarray, start: np.ndarray, along: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Square of the distance (...) of a position from a segment."""
    share = np.clip(_dot(position - start, along) / np.where(square > 0, square, 1.0), 0.0, 1.0)
    rest = position - start - share[..., None] * along
    return _dot(rest, rest)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i", a, b)
