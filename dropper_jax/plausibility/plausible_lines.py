"""Doubtful lengths, masses and spans of lines, before anything is solved."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from itertools import permutations
from typing import NamedTuple

import numpy as np

from dropper_jax.base.markdown import first_names
from dropper_jax.base.records import by_name, names_of
from dropper_jax.load.scene import Scene
from dropper_jax.plausibility.line_weights import MOST_NAMES
from dropper_jax.scene import LineSpec, whole_lines

#: Ratio of the length of a line to the distance of its ends that only a wrong unit explains: mm for m is 1000, cm 100.
LONGEST_LINE = 50.0
#: A loop between points that are close together hangs down: its length is also compared with this number of depths.
LOOP_DEPTHS = 3.0
#: Density of steel, and one that no metal has, even as a chain with the diameter of its bar [kg/m^3].
STEEL = 7850.0
DENSEST = 30_000.0
#: Ratio of thickness to length of a link without diameter, as a bar of steel of its mass; one of g for kg is 30 times
#: as thick as it should be.
THICKEST = 0.5
#: Strain of a line at rest above which it is too short, if it has no breaking load (that of `pose_remarks`).
LARGEST_STRAIN = 0.1


def check_lengths(scene: Scene) -> Iterator[str]:
    """Lines that are many times longer than the distance of their ends."""
    longest_loop = 0.0
    if scene.sea is not None:
        longest_loop = LOOP_DEPTHS * scene.sea.depth
    for line in whole_lines(scene):
        distance = _distance(scene, line.spec)
        total = line.spec.total
        if distance > 1e-6 * total and total > max(LONGEST_LINE * distance, longest_loop):
            yield (
                f"{line.name}: {total:.4g} m long, with links of up to {np.max(line.spec.length):.4g} m, between "
                f"points {distance:.4g} m apart; check the unit of its length, m"
            )


def _distance(scene: Scene, line: LineSpec) -> float:
    """Distance [m] of the ends of a line, as given."""
    return float(np.linalg.norm(scene.point(line.end).position - scene.point(line.start).position))


def check_masses(scene: Scene) -> Iterator[str]:
    """Links denser than any metal, or without diameter and thicker than long as bars of steel."""
    for line in whole_lines(scene):
        spec = line.spec
        per_metre = spec.mass / spec.length
        if spec.diameter is None:
            value = np.sqrt(4.0 * per_metre / (np.pi * STEEL))
            wrong = value > THICKEST * spec.length
            what = "as much as a bar of steel {:.2g} m thick; check the unit of its mass, kg"
        else:
            value = 4.0 * per_metre / (np.pi * spec.diameter**2)
            wrong = value > DENSEST
            what = "{:.3g} kg/m^3, denser than any metal; check mass, kg, and diameter, m"
        worst = int(np.argmax(np.where(wrong, spec.mass, 0.0)))
        if wrong[worst]:
            link = f"{spec.mass[worst]:.4g} kg in a link of {spec.length[worst]:.4g} m, {per_metre[worst]:.4g} kg/m"
            yield f"{line.name}: {link}: {what.format(value[worst])}"


class _Path(NamedTuple):
    """A path along lines and through rigid bodies: its length [m], the point at its end, numbers of its lines."""

    length: float
    end: str
    lines: tuple[int, ...]


class _Overload(NamedTuple):
    """A path that is too short for the distance of its ends.

    Attributes:
        start: the point at its start.
        path: the path.
        distance: of its ends [m].
        tension: at rest [N].
        limit: maximum tension that its lines bear [N].
        breaks: whether a line breaks at this limit; otherwise it is stretched by `LARGEST_STRAIN`.
    """

    start: str
    path: _Path
    distance: float
    tension: float
    limit: float
    breaks: bool


def check_spans(scene: Scene, only_broken: bool) -> Iterator[str]:
    """Lines too short for the distance of the fixed points that they connect.

    Args:
        only_broken: only those that break, not those that are stretched.
    """
    found = []
    names: dict[str, None] = {}
    for overload in _overloads(scene):
        if overload.breaks or not only_broken:
            found.append(overload)
            lines = [scene.lines[i] for i in overload.path.lines]
            names |= dict.fromkeys(line.piece_of or line.name for line in lines)
    if not found:
        return
    worst = max(found, key=lambda one: one.tension / one.limit)
    written = [line for line in whole_lines(scene) if line.name in names]
    short = [line for line in written if line.spec.total < _distance(scene, line.spec)]
    if short:
        spec = max((line.spec for line in short), key=lambda spec: _distance(scene, spec) / spec.total)
        apart = f"{spec.total:.4g} m between points {_distance(scene, spec):.4g} m apart"
        what = f"{first_names(names_of(short), MOST_NAMES)}: {apart}"
    else:
        what = (
            f"{first_names(list(names), MOST_NAMES)}: {worst.path.length:.4g} m of lines between {worst.start!r} and "
            f"{worst.path.end!r}, {worst.distance:.4g} m apart"
        )
    above = f"stretched by more than {LARGEST_STRAIN:.0%}"
    if worst.breaks:
        above = f"above the breaking load of {worst.limit:.4g} N"
    yield f"{what}: about {worst.tension:.3g} N at rest, {above}; check lengths and positions"


def _overloads(scene: Scene) -> Iterator[_Overload]:
    """Shortest paths between fixed points, not of rigid lines alone, with more tension at rest than they bear.

    The tension is that of springs in series, `(distance - length)/sum(l/EA)`.
    """
    points = by_name(scene.points)
    fixed = {name for name, point in points.items() if not point.is_free or scene.start.kind == "points"}
    along = _neighbours(scene)
    for start in sorted(fixed):
        for path in _shortest_paths(start, along, fixed):
            distance = float(np.linalg.norm(points[path.end].position - points[start].position))
            lines = [scene.lines[i] for i in path.lines]
            flexibility = sum(float(np.sum(line.length / line.EA)) for line in lines if line.EA is not None)
            if start >= path.end or path.length >= distance or not flexibility:
                continue
            tension = (distance - path.length) / flexibility
            limit, breaks = min(limit for line in lines for limit in _limits(line))
            if tension > limit:
                yield _Overload(start, path, distance, tension, limit, breaks)


def _limits(line: LineSpec) -> Iterator[tuple[float, bool]]:
    """Tensions [N] above which a line breaks (True), or is stretched too far (False)."""
    if line.breaking_load is not None:
        yield float(np.min(line.breaking_load)), True
    if line.EA is not None:
        yield LARGEST_STRAIN * float(np.min(line.EA)), False


def _neighbours(scene: Scene) -> dict[str, list[_Path]]:
    """The lines and rigid bodies that connect each point with others."""
    found: dict[str, list[_Path]] = {point.name: [] for point in scene.points}
    for i, line in enumerate(scene.lines):
        found[line.start].append(_Path(line.total, line.end, (i,)))
        found[line.end].append(_Path(line.total, line.start, (i,)))
    for body in scene.bodies:
        for one, other in permutations(body.attachments, 2):
            size = float(np.linalg.norm(body.attachments[one] - body.attachments[other]))
            found[one].append(_Path(size, other, ()))
    return found


def _shortest_paths(start: str, along: dict[str, list[_Path]], fixed: set[str]) -> list[_Path]:
    """The shortest path from a point to each fixed point that is reached without another (Dijkstra)."""
    found: dict[str, _Path] = {}
    ahead = [_Path(0.0, start, ())]
    while ahead:
        path = heapq.heappop(ahead)
        if path.end in found:
            continue
        found[path.end] = path
        if path.end == start or path.end not in fixed:
            for more in along[path.end]:
                heapq.heappush(ahead, _Path(path.length + more.length, more.end, path.lines + more.lines))
    return [path for name, path in found.items() if name in fixed and name != start]
