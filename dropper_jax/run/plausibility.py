"""Warnings of scenes that are valid but can hardly be meant, before anything is solved.

Each rule compares two values of the scene: positions with the seabed, lengths with distances, masses with sizes, floats
with the weight that they carry, currents with those of the sea. A limit is far from any scene that works.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from itertools import permutations
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.checks_system import body_warnings, motion_warnings
from dropper_jax.load.checks_water import bed_height
from dropper_jax.load.scene import Scene
from dropper_jax.run.growth import floating_warnings, lines_in_words, wet_weights
from dropper_jax.scene import BodySpec, LineSpec, PointSpec, line_slices, whole_lines
from dropper_jax.sea.spec import SeaSpec

#: Speed [m/s] that no current at a farm reaches: the fastest tidal streams of the world have 8 to 10 m/s, in narrows.
FASTEST_CURRENT = 5.0
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
#: Height of an anchor above the seabed that a block or a screw may have: at least 1 m, or this fraction of the depth.
ANCHOR_HEIGHT = 1.0
ANCHOR_SHARE = 0.05
#: Fraction of the given height of a float over its anchor at which it must at least float.
GUESSED_HEIGHT = 0.5
#: Height above the surface, as a fraction of the depth, that fairleads of ships and platforms do not reach.
HIGH_IN_THE_AIR = 0.5


def scene_warnings(scene: Scene, at_rest: bool = False) -> tuple[str, ...]:
    """Warnings that follow from the scene alone; those of its waves are `sea_warnings`.

    Args:
        at_rest: its equilibrium is known, and `pose_remarks` report how far lines are stretched.
    """
    return (
        *scene.notes,
        *motion_warnings(scene),
        *body_warnings(scene),
        *floating_warnings(scene),
        *plausibility_warnings(scene, at_rest),
    )


def plausibility_warnings(scene: Scene, at_rest: bool = False) -> tuple[str, ...]:
    """A warning for each cause that makes the scene impossible or doubtful; `at_rest` as in `scene_warnings`."""
    return (
        *_check_current(scene),
        *_check_fixed_points(scene),
        *_check_lengths(scene),
        *_check_spans(scene, at_rest),
        *_check_masses(scene),
        *_check_lift(scene),
    )


def with_cause(error: SceneError, scene: Scene) -> SceneError:
    """The error of a start, after the doubtful value that most likely caused it, if there is one."""
    causes = plausibility_warnings(scene)
    if causes:
        return SceneError(f"{causes[0]}; {error}")
    return error


def fastest_current(scene: Scene) -> float:
    """Maximum speed [m/s] of the current over depth and time; 0 without one."""
    current = None if scene.sea is None else scene.sea.current
    if current is None:
        return 0.0
    if current.kind == "table":
        speeds = np.linalg.norm(current.velocities, axis=1)
    else:
        speeds = np.abs(current.speed)
    factor = 1.0
    if current.amplitude is not None:
        factor = float(np.sum(np.abs(current.amplitude)))
    elif current.factor is not None:
        factor = float(np.max(np.abs(current.factor)))
    return factor * float(np.max(speeds))


def _check_current(scene: Scene) -> Iterator[str]:
    speed = fastest_current(scene)
    if speed > FASTEST_CURRENT:
        yield f"sea.current: {speed:.4g} m/s, more than {FASTEST_CURRENT:g} m/s; check its unit, m/s"


# --- points ---


class Connected(NamedTuple):
    """Lines that are joined at free points and bodies, and the fixed points that hold them.

    Attributes:
        lines: numbers of the lines.
        held, free: the fixed points at their ends, and the free ones.
        bodies: the rigid bodies to which they are attached.
    """

    lines: list[int]
    held: list[PointSpec]
    free: list[PointSpec]
    bodies: list[BodySpec]


def _connected(scene: Scene) -> list[Connected]:
    """The systems of lines that only fixed points have in common."""
    points = {point.name: point for point in scene.points}
    label = {name: point.on if point.on and point.is_free else name for name, point in points.items()}
    parent = {name: name for name in label.values()}

    def root(name: str) -> str:
        while parent[name] != name:
            name = parent[name]
        return name

    for line in scene.lines:
        if points[line.start].is_free and points[line.end].is_free:
            parent[root(label[line.start])] = root(label[line.end])
    bodies = {body.name: body for body in scene.bodies}
    found: dict[str, Connected] = {}
    for i, line in enumerate(scene.lines):
        ends = [points[line.start], points[line.end]]
        free = next((point for point in ends if point.is_free), None)
        key = f"line {i}" if free is None else root(label[free.name])
        system = found.setdefault(key, Connected([], [], [], []))
        system.lines.append(i)
        for point in ends:
            own = system.free if point.is_free else system.held
            if point not in own:
                own.append(point)
            body = bodies.get(point.on)
            if body is not None and body not in system.bodies:
                system.bodies.append(body)
    return list(found.values())


def _lifts(scene: Scene, sea: SeaSpec, system: Connected) -> list[tuple[float, float]]:
    """Height [m] and lift under water, buoyancy less weight [N], of each float, mass, buoy and body of a system."""
    names = {point.name: point for point in system.free}
    items = [(p.position[2], p.volume or 0.0, p.mass or 0.0) for p in system.free if p.body]
    items += [
        (names[buoy.point].position[2], 0.25 * np.pi * buoy.diameter**2 * buoy.height, buoy.mass)
        for buoy in scene.buoys
        if buoy.point in names
    ]
    for body in system.bodies:
        volume = sum(0.25 * np.pi * c.diameter**2 * c.length for c in body.cylinders)
        volume += sum(np.pi / 6.0 * s.diameter**3 for s in body.spheres)
        items.append((body.position[2], volume, body.mass))
    return [(float(z), sea.gravity * (sea.density * float(volume) - float(mass))) for z, volume, mass in items]


def _moved_points(scene: Scene) -> set[str]:
    """Names of fixed points that an effect or a vessel moves."""
    moved = {point.name for point in scene.points if point.on}
    for values in scene.effects.values():
        names = [values.get("point"), *(values.get("also") or ()), *(values.get("points") or ())]
        moved |= {name for name in names if isinstance(name, str)}
    return moved


def _check_fixed_points(scene: Scene) -> Iterator[str]:
    """Anchors that are not on the seabed: by their name or `[[anchor]]`, or because they alone hold floats."""
    if scene.sea is None:
        return
    moved = _moved_points(scene)
    held = {point.name: point for point in scene.points if not point.is_free and point.name not in moved}
    depth = scene.sea.depth
    heights = _heights(scene, list(held.values()), -depth)
    allowed = max(ANCHOR_HEIGHT, ANCHOR_SHARE * depth)
    high = {name for name, height in heights.items() if height > allowed}
    entries = {anchor.point for anchor in scene.anchors}
    doubtful = {name for name in high if "anchor" in name.lower() or name in entries}
    for system in _connected(scene):
        names = [point.name for point in system.held]
        if not any(lift > 0.0 for _, lift in _lifts(scene, scene.sea, system)) or not set(names) <= set(held):
            continue
        doubtful |= {name for name in names if held[name].position[2] > HIGH_IN_THE_AIR * depth}
        if set(names) <= high:  # floats on mooring lines from mid-water
            doubtful |= {name for name in names if held[name].position[2] < -0.5 * depth}
    above = [name for name in held if name in doubtful and held[name].position[2] > 0.0]
    below = [name for name in held if name in doubtful and name not in above]
    if above:
        yield (
            f"{lines_in_words(above)}: fixed {_range([held[name].position[2] for name in above])} m above the surface "
            f"of water {depth:.4g} m deep; z is upwards from the surface, check the sign"
        )
    if below:
        yield (
            f"{lines_in_words(below)}: fixed {_range([heights[name] for name in below])} m above the seabed; check the "
            "positions and the depth"
        )


def _heights(scene: Scene, points: list[PointSpec], flat: float) -> dict[str, float]:
    """Height [m] of points above the seabed, by name; without [effects.seabed] it is flat at that z [m]."""
    positions = np.array([point.position for point in points]).reshape(-1, 3)
    bed = bed_height(scene, positions)
    bed = np.full(len(points), flat) if bed is None else bed
    return {point.name: float(z) for point, z in zip(points, positions[:, 2] - bed, strict=True)}


def _range(values: list[float]) -> str:
    low = f"{min(values):.3g}"
    high = f"{max(values):.3g}"
    if low == high:
        return low
    return f"{low} to {high}"


def _check_lift(scene: Scene) -> Iterator[str]:
    """Floats that cannot carry what hangs on them: masses, lines without a fixed end, and parts of the moorings."""
    if scene.sea is None or "weight" not in scene.effects:
        return
    depth = scene.sea.depth
    weights = wet_weights(scene)
    whole = [float(np.sum(weights[where.links])) for where in line_slices(scene)]
    sinking = []
    for system in _connected(scene):
        lifts = _lifts(scene, scene.sea, system)
        floats = [z for z, lift in lifts if lift > 0.0]
        # those near the seabed may be meant to stand on it, and those below a fixed point hang on it
        if not floats or max(floats) < -0.5 * depth or any(p.position[2] > -0.5 * depth for p in system.held):
            continue
        own = sum(lift for _, lift in lifts)
        lines = sum(whole[i] * _carried_share(scene, scene.lines[i], whole[i]) for i in system.lines)
        if own < lines:
            sinking.append((own, lines))
    if sinking:
        own, lines = min(sinking, key=lambda pair: pair[0] - pair[1])
        if len(sinking) > 1:
            more = f" (and {len(sinking) - 1} more systems)"
        else:
            more = ""
        yield (
            f"floats: their net lift with all masses is {own:.4g} N, and lines of {lines:.4g} N hang on them{more}: "
            "the system sinks until it lies on the seabed; check volumes and masses"
        )


def _carried_share(scene: Scene, line: LineSpec, weight: float) -> float:
    """Fraction of a line of that weight in water [N] that floats carry at least."""
    ends = [scene.point(line.start), scene.point(line.end)]
    if weight <= 0.0 or all(point.is_free for point in ends):
        return 1.0
    # a mooring hangs at least straight down from its float, whose depth is a first guess
    height = abs(float(ends[1].position[2] - ends[0].position[2]))
    if any(point.is_free for point in ends):
        return GUESSED_HEIGHT * min(height / line.total, 1.0)
    return 0.0


# --- lines ---


def _check_lengths(scene: Scene) -> Iterator[str]:
    """Lines that are many times longer than the distance of their ends."""
    least = 0.0 if scene.sea is None else LOOP_DEPTHS * scene.sea.depth
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


def _check_masses(scene: Scene) -> Iterator[str]:
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


class _Path(NamedTuple):
    """The shortest way along lines between two fixed points: their distance [m], its length [m], numbers of lines."""

    ends: tuple[str, str]
    distance: float
    length: float
    lines: tuple[int, ...]


def _check_spans(scene: Scene, only_broken: bool) -> Iterator[str]:
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
    short = [
        (line.name, line.spec.total, _distance(scene, line.spec))
        for line in whole_lines(scene)
        if line.name in names and line.spec.total < _distance(scene, line.spec)
    ]
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


def _neighbours(scene: Scene) -> dict[str, list[tuple[str, float, tuple[int, ...]]]]:
    """Points that a line, or a rigid body, connects with each point: their names, the length [m], the line."""
    found: dict[str, list[tuple[str, float, tuple[int, ...]]]] = {point.name: [] for point in scene.points}
    for i, line in enumerate(scene.lines):
        found[line.start].append((line.end, line.total, (i,)))
        found[line.end].append((line.start, line.total, (i,)))
    for body in scene.bodies:
        for one, other in permutations(body.attachments, 2):
            size = float(np.linalg.norm(body.attachments[one] - body.attachments[other]))
            found[one].append((other, size, ()))
    return found


def _shortest_ways(
    start: str, along: dict[str, list[tuple[str, float, tuple[int, ...]]]], fixed: set[str]
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
