"""Doubtful lengths, masses and spans of lines, before anything is solved."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from itertools import permutations
from typing import NamedTuple

import numpy as np

from dropper_jax.load.scene import Scene
from dropper_jax.run.line_weights import lines_in_words
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
    least = 0.0
    if scene.sea is not None:
        least = LOOP_DEPTHS * scene.sea.depth
    for line in whole_lines(scene):
        distance = _distance(scene, line.spec)
        total = line.spec.total
        if distance > 1e-6 * total and total > max(LONGEST_LINE * distance, least):
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
            thickness = np.sqrt(4.0 * per_metre / (np.pi * STEEL))
            wrong = thickness > THICKEST * spec.length
        else:
            density = 4.0 * per_metre / (np.pi * spec.diameter**2)
            wrong = density > DENSEST
        if not np.any(wrong):
            continue
        worst = int(np.argmax(np.where(wrong, spec.mass, 0.0)))
        link = f"{spec.mass[worst]:.4g} kg in a link of {spec.length[worst]:.4g} m, {per_metre[worst]:.4g} kg/m"
        if spec.diameter is None:
            what = f"as much as a bar of steel {thickness[worst]:.2g} m thick; check the unit of its mass, kg"
        else:
            what = f"{density[worst]:.3g} kg/m^3, denser than any metal; check mass, kg, and diameter, m"
        yield f"{line.name}: {link}: {what}"


#: A connection to a point: its name, the length [m], numbers of the lines.
Connection = tuple[str, float, tuple[int, ...]]


class _Path(NamedTuple):
    """The shortest way along lines between two fixed points: their distance [m], its length [m], numbers of lines."""

    ends: tuple[str, str]
    distance: float
    length: float
    lines: tuple[int, ...]


def check_spans(scene: Scene, only_broken: bool) -> Iterator[str]:
    """Lines too short for the distance of the fixed points that they connect; only those that break."""
    worst = None
    names: dict[str, None] = {}
    for path in _taut_paths(scene):
        tension, limit = _rest_tension(scene, path)
        if tension <= limit[0] or (only_broken and not limit[1]):
            continue
        names |= dict.fromkeys(scene.lines[i].piece_of or scene.lines[i].name for i in path.lines)
        if worst is None or tension / limit[0] > worst[0] / worst[1][0]:
            worst = tension, limit, path
    if worst is None:
        return
    tension, (strong, broken), path = worst
    short = []
    for line in whole_lines(scene):
        if line.name in names and line.spec.total < _distance(scene, line.spec):
            short.append((line.name, line.spec.total, _distance(scene, line.spec)))
    if short:
        which = max(short, key=lambda row: row[2] / row[1])
        what = f"{lines_in_words([row[0] for row in short])}: {which[1]:.4g} m between points {which[2]:.4g} m apart"
    else:
        what = (
            f"{lines_in_words(list(names))}: {path.length:.4g} m of lines between {path.ends[0]!r} and "
            f"{path.ends[1]!r}, {path.distance:.4g} m apart"
        )
    if broken:
        above = f"above the breaking load of {strong:.4g} N"
    else:
        above = f"stretched by more than {LARGEST_STRAIN:.0%}"
    yield f"{what}: about {tension:.3g} N at rest, {above}; check lengths and positions"


def _rest_tension(scene: Scene, path: _Path) -> tuple[float, tuple[float, bool]]:
    """Tension [N] that stretches a path to the distance of its ends, the largest that it bears, and whether that is a
    breaking load."""
    lines = [scene.lines[i] for i in path.lines]
    flexibility = sum(float(np.sum(line.length / line.EA)) for line in lines if line.EA is not None)
    tension = (path.distance - path.length) / flexibility
    limits = [(float(np.min(line.breaking_load)), True) for line in lines if line.breaking_load is not None]
    limits += [(LARGEST_STRAIN * float(np.min(line.EA)), False) for line in lines if line.EA is not None]
    return tension, min(limits)


def _taut_paths(scene: Scene) -> Iterator[_Path]:
    """Shortest paths between fixed points, not of rigid lines alone, that are shorter than the points' distance."""
    points = {point.name: point for point in scene.points}
    fixed = {name for name, point in points.items() if not point.is_free or scene.start.kind == "points"}
    along = _neighbours(scene)
    for start in sorted(fixed):
        for end, (total, way) in _shortest_ways(start, along, fixed).items():
            distance = float(np.linalg.norm(points[end].position - points[start].position))
            if start < end and total < distance and any(not scene.lines[i].rigid for i in way):
                yield _Path((start, end), distance, total, way)


def _neighbours(scene: Scene) -> dict[str, list[Connection]]:
    """Points that a line, or a rigid body, connects with each point: their names, the length [m], the line."""
    found: dict[str, list[Connection]] = {point.name: [] for point in scene.points}
    for i, line in enumerate(scene.lines):
        found[line.start].append((line.end, line.total, (i,)))
        found[line.end].append((line.start, line.total, (i,)))
    for body in scene.bodies:
        for one, other in permutations(body.attachments, 2):
            size = float(np.linalg.norm(body.attachments[one] - body.attachments[other]))
            found[one].append((other, size, ()))
    return found


def _shortest_ways(
    start: str, along: dict[str, list[Connection]], fixed: set[str]
) -> dict[str, tuple[float, tuple[int, ...]]]:
    """Length and lines of the shortest way from a point to each fixed point reached without another (Dijkstra)."""
    found: dict[str, tuple[float, tuple[int, ...]]] = {}
    open_ways: list[tuple[float, str, tuple[int, ...]]] = [(0.0, start, ())]
    while open_ways:
        length, here, way = heapq.heappop(open_ways)
        if here in found:
            continue
        found[here] = length, way
        for there, more, line in along[here] if here == start or here not in fixed else ():
            if there not in found:
                heapq.heappush(open_ways, (length + more, there, (*way, *line)))
    return {name: pair for name, pair in found.items() if name in fixed and name != start}
