"""Doubtful positions of fixed points, and lines that nothing holds up or down."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from dropper_jax.base.markdown import first_names
from dropper_jax.base.records import by_name, names_of
from dropper_jax.load.scene import Scene
from dropper_jax.load.surface import bed_height
from dropper_jax.plausibility.line_weights import MOST_NAMES, wet_weights
from dropper_jax.scene import LineSpec, PointSpec, line_slices
from dropper_jax.sea.spec import SeaSpec

#: Height of an anchor above the seabed that a block or a screw may have: at least 1 m, or this fraction of the depth.
ANCHOR_HEIGHT = 1.0
ANCHOR_SHARE = 0.05
#: Fraction of the given height of a float over its anchor at which it must at least float.
GUESSED_HEIGHT = 0.5
#: Height above the surface, as a fraction of the depth, that fairleads of ships and platforms do not reach.
HIGH_IN_THE_AIR = 0.5


class Connected(NamedTuple):
    """Lines that are joined at free points and bodies, and the fixed points that hold them.

    Attributes:
        lines: numbers of the lines.
        points: the points at their ends by name.
    """

    lines: list[int]
    points: dict[str, PointSpec]

    @property
    def fixed_points(self) -> list[PointSpec]:
        """The fixed points."""
        return [point for point in self.points.values() if not point.is_free]


def _connected(scene: Scene) -> list[Connected]:
    """The systems of lines that only fixed points have in common."""
    points = by_name(scene.points)
    # the points of a body are one
    label = {name: point.carrier if point.carrier and point.is_free else name for name, point in points.items()}
    parent = {name: name for name in label.values()}

    def root(name: str) -> str:
        while parent[name] != name:
            parent[name] = parent[parent[name]]  # so that the next search takes half as long
            name = parent[name]
        return name

    for line in scene.lines:
        if points[line.start].is_free and points[line.end].is_free:
            parent[root(label[line.start])] = root(label[line.end])
    systems: dict[str, Connected] = {}
    for i, line in enumerate(scene.lines):
        free = [name for name in (line.start, line.end) if points[name].is_free]
        key = root(label[free[0]]) if free else f"line {i}"
        system = systems.setdefault(key, Connected([], {}))
        system.lines.append(i)
        system.points.update({name: points[name] for name in (line.start, line.end)})
    return list(systems.values())


def _lifts(scene: Scene, sea: SeaSpec, system: Connected) -> list[tuple[float, float]]:
    """Height [m] and lift under water, buoyancy less weight [N], of each float, mass, buoy and body of a system."""
    free = [point for point in system.points.values() if point.is_free]
    items = [(point.position, point.volume or 0.0, point.mass or 0.0) for point in free if point.has_body]
    for buoy in scene.buoys:
        if buoy.point in system.points:
            volume = 0.25 * np.pi * buoy.diameter**2 * buoy.height
            items.append((system.points[buoy.point].position, volume, buoy.mass))
    carriers = {point.carrier for point in free}
    for body in scene.bodies:
        if body.name in carriers:
            volume = sum(0.25 * np.pi * c.diameter**2 * c.length for c in body.cylinders)
            volume += sum(np.pi / 6.0 * s.diameter**3 for s in body.spheres)
            items.append((body.position, volume, body.mass))
    return [(float(at[2]), sea.gravity * float(sea.density * volume - mass)) for at, volume, mass in items]


def _moved_points(scene: Scene) -> set[str]:
    """Names of fixed points that an effect or a vessel moves."""
    moved = {point.name for point in scene.points if point.carrier}
    for values in scene.effects.values():
        names = [values.get("point"), *(values.get("also") or ()), *(values.get("points") or ())]
        moved |= {name for name in names if isinstance(name, str)}
    return moved


def seabed_under(scene: Scene, positions: np.ndarray) -> np.ndarray:
    """Height [m] of the seabed at positions (n, 3) [m]: as given, or at the depth of the water."""
    bed = bed_height(scene, positions)
    if bed is None:
        return np.full(len(positions), -scene.needed_sea.depth)
    return bed


def check_fixed_points(scene: Scene) -> Iterator[str]:
    """Anchors that are not on the seabed: points with such a name or an `[[anchor]]`, or that alone hold floats."""
    if scene.sea is None:
        return
    moved = _moved_points(scene)
    held = {point.name: point.position for point in scene.points if not point.is_free and point.name not in moved}
    depth = scene.sea.depth
    positions = np.array(list(held.values())).reshape(-1, 3)
    heights = dict(zip(held, positions[:, 2] - seabed_under(scene, positions), strict=True))
    allowed = max(ANCHOR_HEIGHT, ANCHOR_SHARE * depth)
    high = {name for name, height in heights.items() if height > allowed}
    entries = {anchor.point for anchor in scene.anchors}
    doubtful = {name for name in high if "anchor" in name.lower() or name in entries}
    for system in _connected(scene):
        names = set(names_of(system.fixed_points))
        if not any(lift > 0.0 for _, lift in _lifts(scene, scene.sea, system)) or not names <= held.keys():
            continue
        doubtful |= {name for name in names if held[name][2] > HIGH_IN_THE_AIR * depth}
        if names <= high:  # floats on mooring lines from mid-water
            doubtful |= {name for name in names if held[name][2] < -0.5 * depth}
    above = {name: held[name][2] for name in held if name in doubtful and held[name][2] > 0.0}
    below = {name: heights[name] for name in held if name in doubtful and name not in above}
    if above:
        yield (
            f"{_fixed(above)} m above the surface of water {depth:.4g} m deep; z is upwards from the surface, "
            "check the sign"
        )
    if below:
        yield f"{_fixed(below)} m above the seabed; check the positions and the depth"


def _fixed(heights: dict[str, float]) -> str:
    """Names of points, and the minimum and maximum of their heights; one number if they are equal."""
    ends = dict.fromkeys(f"{end(heights.values()):.3g}" for end in (min, max))
    return f"{first_names(list(heights), MOST_NAMES)}: fixed {' to '.join(ends)}"


def check_lift(scene: Scene) -> Iterator[str]:
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
        # those near the seabed may be meant to rest on it, and those below a fixed point hang on it
        if not floats or max(floats) < -0.5 * depth or any(p.position[2] > -0.5 * depth for p in system.fixed_points):
            continue
        own = sum(lift for _, lift in lifts)
        lines = sum(whole[i] * _carried_share(scene, scene.lines[i], whole[i]) for i in system.lines)
        if own < lines:
            sinking.append((own, lines))
    if sinking:
        own, lines = min(sinking, key=lambda pair: pair[0] - pair[1])
        more = ""
        if len(sinking) > 1:
            more = f" (and {len(sinking) - 1} more systems)"
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
