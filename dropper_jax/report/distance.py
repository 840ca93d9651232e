"""Distance between lines: the nearest approach of their links over a run."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import Record, arc
from dropper_jax.scene import WholeLine


class Approach(NamedTuple):
    """The minimum distance of two lines [m], its sample, the other line, and the links of both."""

    distance: float
    sample: int
    other: int
    link: int
    other_link: int


def line_distances(record: Record) -> list[Table] | dict[str, str]:
    """Per line: the nearest line, the minimum distance of the axes [m], its time [s] and arc length along both [m].

    The distance is exact between straight links at the saved times (of a long record at 2000 of them). Links
    that end in a common point of both lines are left out.
    """
    lines = record.written_lines
    if len(lines) == 1:
        return {"skipped": "one line"}
    nodes = [record.positions[:, line.nodes] for line in lines]
    low = np.stack([own.min(axis=(0, 1)) for own in nodes])
    high = np.stack([own.max(axis=(0, 1)) for own in nodes])
    gap = np.linalg.norm(np.maximum(np.maximum(low[:, None] - high, low - high[:, None]), 0.0), axis=-1)
    nearest: dict[int, Approach] = {}
    for a, b in sorted(combinations(range(len(lines)), 2), key=lambda pair: gap[pair]):
        # boxes at this distance cannot contain a closer pair than the present one
        if all(i in nearest and gap[a, b] >= nearest[i].distance for i in (a, b)):
            continue
        near = _nearest(record, a, b)
        if near is None:
            continue
        seen_from_b = near._replace(other=a, link=near.other_link, other_link=near.link)
        for i, approach in ((a, near), (b, seen_from_b)):
            if i not in nearest or approach.distance < nearest[i].distance:
                nearest[i] = approach
    return [_describe_distance(record, line, nearest.get(i)) for i, line in enumerate(lines)]


#: Maximum number of evenly spaced instants that are compared, for the time that they take. Approaches between them are
#: missed: `sampled_every_s` reports how far apart they are.
COMPARED_INSTANTS = 2000


def sample_stride(record: Record) -> int:
    """Number of samples from one compared instant to the next."""
    return -(-len(record.t) // COMPARED_INSTANTS)


def _describe_distance(record: Record, line: WholeLine, near: Approach | None) -> Table:
    if near is None:
        return {"line": line.name, "nearest": None, "least_distance_m": None}
    other = record.written_lines[near.other]
    touching = None
    if line.spec.diameter is not None and other.spec.diameter is not None:
        # the distance of axes in contact
        touching = float(0.5 * (np.max(line.spec.diameter) + np.max(other.spec.diameter)))
    return {
        "line": line.name,
        "nearest": other.name,
        "least_distance_m": near.distance,
        "t_s": float(record.t[near.sample]),
        "at_m": float(arc(line.spec.length)[near.link]),
        "nearest_at_m": float(arc(other.spec.length)[near.other_link]),
        "sampled_every_s": sample_stride(record) * record.interval,
        "diameters_m": touching,
    }


#: Pairs of links and instants that are compared at once: 1e6 need some tens of MB.
PAIRS_AT_ONCE = 100_000


def _nearest(record: Record, a: int, b: int) -> Approach | None:
    """The nearest approach of two lines over all samples; None if no links are compared."""
    lines = record.written_lines
    i, j = _pairs(lines[a], lines[b])
    if not i.size:
        return None
    first = record.positions[:, lines[a].nodes]
    second = record.positions[:, lines[b].nodes]
    step = max(1, PAIRS_AT_ONCE // i.size)
    best = None
    looked = np.arange(0, len(record.t), sample_stride(record))
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

    The nearest position on the line of the second segment to that on the first, both cut to the segments in turn.

    Source: Ericson, Real-Time Collision Detection (2005), section 5.1.9.
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
    crossed = det > 1e-12 * a * c  # of parallel lines any position on the first one is nearest
    s = np.clip(np.where(crossed, b * e - c * d, 0.0) / np.where(crossed, det, 1.0), 0.0, 1.0)
    t = np.clip((b * s + e) / np.where(c > 0, c, 1.0), 0.0, 1.0)
    s = np.clip((b * t - d) / np.where(a > 0, a, 1.0), 0.0, 1.0)
    return np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i", a, b)
