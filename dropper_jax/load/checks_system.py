"""Consistency of lines, points, bodies and vessels of a scene."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from dropper_jax.base.errors import Check, SceneError, nearest, raise_first, raises_first
from dropper_jax.base.read import refuse, short_text
from dropper_jax.base.records import by_name, names_of
from dropper_jax.effects import EFFECTS
from dropper_jax.load.checks_water import BELOW_BED, check_growth, check_water
from dropper_jax.load.surface import bed_height
from dropper_jax.scene import (
    BodySpec,
    BuoySpec,
    LineSpec,
    PointSpec,
    SceneData,
    VesselSpec,
    check_anchors,
    sliced_lines,
)
from dropper_jax.scene.start import rows_of_pieces

AT_LEAST_2 = "allowed: a whole number >= 2"


@raises_first
def check_layout(scene: SceneData) -> Iterator[Check]:
    """Check names, ends of lines, anchors, failures and the lines that grow."""
    for section, named in (("point", scene.points), ("line", scene.lines), ("buoy", scene.buoys)):
        yield from _name_checks(section, named)
    _check_ends(scene)
    line = scene.single_line
    if line is None:
        yield from _system_checks(scene)
    else:
        yield from _line_checks(scene, line)
    check_anchors(scene.anchors, scene.fixed_points)
    lines = by_name(scene.lines)
    for i, failure in enumerate(scene.failures):
        raise_first(failure.line_checks(lines), f"failure.{i}")
    if scene.season is not None:
        lines_and_pieces = [(line.name, line.piece_of) for line in scene.lines]
        raise_first(scene.season.line_checks(lines_and_pieces), "growth")


def _name_checks(
    section: str, named: Sequence[PointSpec | LineSpec | BuoySpec | BodySpec | VesselSpec]
) -> Iterator[Check]:
    """Checks that every item of a section has a unique name."""
    names: set[str] = set()
    for i, item in enumerate(named):
        yield item.name in names, f"{section}.{i}.name: {short_text(item.name)} is used twice; allowed: a unique name"
        names.add(item.name)


def _check_ends(scene: SceneData) -> None:
    """Check that every line ends at points that exist, and that every point is an end of a line."""
    names = names_of(scene.points)
    if not names:
        raise SceneError("point: missing; needed: one or more [[point]] tables")
    known = {*names}
    used: set[str] = set()
    for i, line in enumerate(scene.lines):
        for key, name in (("from", line.start), ("to", line.end)):
            if name not in known:
                raise SceneError(f"line.{i}.{key}: {short_text(name)} is not a point; {nearest(name, names)}")
            used.add(name)
    for i, point in enumerate(scene.points):
        if point.name not in used and point.carrier is None:
            raise refuse(f"point.{i}.name", point.name, "is not an end of any line", ", ".join(sorted(used)))


def _line_checks(scene: SceneData, line: LineSpec) -> Iterator[Check]:
    """Checks that a single line starts at a fixed point, and that links between two fixed ends can close: no side of
    the polygon exceeds the sum of the others."""
    start = scene.point(line.start)
    yield (
        start.is_free,
        f"point.{scene.points.index(start)}.kind: {start.kind!r} cannot be the start of a rigid line; allowed: fixed",
    )
    if scene.point(line.end).is_free:
        return
    yield line.links < 2, f"line.0.links: {line.links} leaves no free node between two fixed ends; {AT_LEAST_2}"
    if line.rigid:
        distance = check_span(scene, 0)
        longest = np.max(line.length)
        others = line.total - longest + distance
        yield (
            longest >= others,
            f"line.0.length: a link of {longest:g} m cannot be closed by the others and the {distance:g} m between "
            f"the ends; allowed: less than {others:g} m",
        )


def _system_checks(scene: SceneData) -> Iterator[Check]:
    """Checks for elastic lines of one law, every point connected to a fixed one, buoys on free points."""
    free = set(scene.free_points)
    for i, line in enumerate(scene.lines):
        if line.rigid and not free & {line.start, line.end}:
            check_span(scene, i)
        yield (
            line.centre_of_mass is not None,
            f"line.{i}.centre_of_mass: compound links are for single lines only. Remove `centre_of_mass`",
        )
        yield (
            line.start == line.end and line.links < 2,
            f"line.{i}.links: {line.links} leaves no free node in a loop; {AT_LEAST_2}",
        )
    yield (
        not free and all(line.links == 1 for line in scene.lines),
        f"line.0.links: {scene.lines[0].links} leaves no free node between fixed points; {AT_LEAST_2}",
    )
    reached = _reached(scene)
    names = names_of(scene.points)
    for i, name in enumerate(names):
        yield (
            name not in reached,
            f"point.{i}.name: {short_text(name)} is not connected to any fixed point; allowed: lines from a point of "
            "kind 'fixed'",
        )
    for i, buoy in enumerate(scene.buoys):
        added = scene.buoys[0].end_added_mass
        yield (
            buoy.end_added_mass != added,
            f"buoy.{i}.end_added_mass: {buoy.end_added_mass!r} differs from that of the first buoy; allowed: {added}",
        )
        if buoy.point not in names:
            raise SceneError(f"buoy.{i}.point: {buoy.point!r} is not a point; {nearest(buoy.point, names)}")
        yield (
            buoy.point not in free,
            f"buoy.{i}.point: {short_text(buoy.point)} is a fixed point; allowed: a point of kind 'free'",
        )


def check_span(scene: SceneData, index: int) -> float:
    """The distance [m] between the ends of a line that stay where they are, which its rigid links must be able to
    span."""
    line = scene.lines[index]
    distance = math.dist(scene.point(line.end).position, scene.point(line.start).position)
    if line.total <= distance:
        raise SceneError(
            f"line.{index}.length: the links are {line.total:g} m long in all, too short for the {distance:g} m "
            f"between {line.start!r} and {line.end!r}; allowed: more than {distance:g} m in all"
        )
    return distance


def _reached(scene: SceneData) -> set[str]:
    """Names of the points that lines connect to a fixed point."""
    reached = {point.name for point in scene.points if not point.is_free or point.carrier}
    before = 0
    while len(reached) > before:
        before = len(reached)
        for line in scene.lines:
            if {line.start, line.end} & reached:
                reached |= {line.start, line.end}
    return reached


@raises_first
def _check_system_effects(scene: SceneData) -> Iterator[Check]:
    """Check that every free point has mass (that of a link, a body or a buoy), effects that need one line, and bodies
    that need water."""
    nodes = scene.link_mass_nodes
    heavy = {line.end for line in scene.lines} | {line.start for line in scene.lines if nodes[line.name] != "far"}
    heavy |= {buoy.point for buoy in scene.buoys}
    heavy |= {point.name for point in scene.points if point.mass or point.carrier or not point.is_free}
    for i, line in enumerate(scene.lines):
        yield (
            line.start not in heavy,
            f"line.{i}.nodes: {line.nodes!r} leaves the free point {line.start!r} without mass; allowed: shared, or "
            "the line written from its other end",
        )
    if scene.single_line is None:
        for name in scene.effects:
            single = EFFECTS[name].single_line
            yield single, f"effects.{name}: acts on the nodes of one line; allowed: scenes with one line"
    for i, buoy in enumerate(scene.buoys):
        yield (
            scene.sea is None,
            f"buoy.{i}: {buoy.name!r} needs water, but the scene has no [sea]; needed: [sea] with `depth`",
        )


@raises_first
def check_bed(scene: SceneData, pose: tuple[str, np.ndarray] | None) -> Iterator[Check]:
    """Check that no point, and no node of a given configuration (its path, and positions (n, 3) [m] of the nodes of all
    lines), starts below the seabed."""
    positions = np.array([point.position for point in scene.points])
    for i, bed in _below_bed(scene, positions, BELOW_BED):
        z = positions[i, 2]
        yield True, f"point.{i}.position: z = {z:g} m is below the seabed; allowed: >= {bed:g} m at its x and y"
    if pose is None:
        return
    path, nodes = pose
    rows = rows_of_pieces(scene.lines)
    loaded = {point.name for point in scene.points if point.has_body} | {buoy.point for buoy in scene.buoys}
    for line, where in sliced_lines(scene):
        own = nodes[where.nodes]
        ends = {0: line.start, line.links: line.end}
        for i, bed in _below_bed(scene, own, _allowed_depth(scene, line)):
            z = own[i, 2]
            node = rows[where.nodes.start + i]
            yield (
                ends.get(i) not in loaded,  # a body presses its point into the seabed
                f"{path}: node {node} is at z = {z:g} m, below the seabed; allowed: >= {bed:g} m at its x and y",
            )


#: Depth in the seabed of a node in motion, over that at which the seabed carries its weight.
MAX_PRESSED = 10.0


def _allowed_depth(scene: SceneData, line: LineSpec) -> float:
    """Depth in the seabed [m] that a node may have in a configuration taken from a run: the thickness of its line, or
    that to which its weight presses it."""
    if line.diameter is None or "seabed" not in scene.effects:
        return np.inf
    weight = scene.gravity * line.mass
    pressed = weight / (scene.effects["seabed"]["stiffness"] * line.diameter * line.length)
    return float(np.max(np.maximum(line.diameter, MAX_PRESSED * pressed)))


def _below_bed(scene: SceneData, positions: np.ndarray, margin: float) -> Iterator[tuple[int, float]]:
    """Positions (n, 3) [m] deeper in the seabed than a margin [m]: their index, and the height of the seabed [m]."""
    bed = bed_height(scene, positions)
    if bed is None:
        return
    for i in np.flatnonzero(positions[:, 2] < bed - margin):
        yield int(i), bed[i]


def attached_points(scene: SceneData) -> tuple[PointSpec, ...]:
    """The bodies' and vessels' attachments as points, at their positions at the start.

    Raises:
        SceneError: a name is used twice.
    """
    raise_first(_name_checks("body", scene.bodies))
    raise_first(_name_checks("vessel", scene.vessels))
    given = set(names_of(scene.points))
    found: dict[str, PointSpec] = {}
    for section, kind, carriers in (("body", "free", scene.bodies), ("vessel", "fixed", scene.vessels)):
        for i, carrier in enumerate(carriers):
            path = f"{section}.{i}.attachments"
            for name, position in carrier.attachments.items():
                if name in given:
                    raise SceneError(
                        f"{path}.{name}: is also a [[point]]; an attachment is a point of its own, to which lines "
                        f"connect by this name. Remove the [[point]] {name!r}, or rename one of the two"
                    )
                if name in found:
                    raise refuse(path, name, "is used twice", "unique names among points")
                found[name] = PointSpec(name=name, position=carrier.world(position), kind=kind, carrier=carrier.name)
    return tuple(found.values())


@raises_first
def _check_bodies(scene: SceneData) -> Iterator[Check]:
    """Check that bodies hang on lines that stretch, and that bodies with shapes are in water."""
    for i, line in enumerate(scene.lines):
        yield (
            line.rigid and bool(scene.bodies),
            f"line.{i}.axial.law: 'rigid' in a scene with bodies. Use lines that stretch, such as 'rope'",
        )
    for i, body in enumerate(scene.bodies):
        yield (
            bool(body.shapes) and scene.sea is None,
            f"body.{i}: {body.name!r} has cylinders or spheres, but the scene has no [sea]; needed: [sea] with "
            "`depth`, or no shapes",
        )
        for what, given in (("cylinders or spheres", body.shapes), ("[effects.seabed]", "seabed" in scene.effects)):
            yield (
                body.touches_bed and not given,
                f"body.{i}.touches_bed: {body.name!r} lacks {what}; allowed: false, or a body and scene with both",
            )


def check_changing_lengths_until(scene: SceneData, end: float) -> None:
    """Check that tables of lengths cover a run that ends at this time [s]."""
    for i, line in enumerate(scene.lines):
        for j, changing in enumerate(line.length_in_time):
            changing.check_run(f"line.{i}.length_in_time.{j}", end)


@raises_first
def check_scene(scene: SceneData) -> Iterator[Check]:
    """Check the parts of a scene against each other: effects with bodies, vessels, water and growth."""
    _check_system_effects(scene)
    _check_bodies(scene)
    for i, vessel in enumerate(scene.vessels):
        yield (
            vessel.rao is not None and (scene.sea is None or scene.sea.waves is None or scene.sea.ramp is None),
            f"vessel.{i}.rao: needs waves that rise from rest; needed: [sea.waves] and `sea.ramp`, or `motion`",
        )
    check_changing_lengths_until(scene, scene.run.duration)
    for effect, values in scene.effects.items():
        if EFFECTS[effect].needs_water or EFFECTS[effect].needs_sea:
            check_water(effect, scene)
        for other in EFFECTS[effect].needs:
            yield other not in scene.effects, f"effects.{effect}: needs [effects.{other}]; it is missing"
        EFFECTS[effect].check(values, scene)
    check_growth(scene)
