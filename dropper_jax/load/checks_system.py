"""Consistency of lines, points, bodies and vessels of a scene, and warnings about them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import refuse, short_text
from dropper_jax.effects import EFFECTS
from dropper_jax.load.checks_water import bed_height, check_growth, check_water
from dropper_jax.scene import BodySpec, BuoySpec, LineSpec, PointSpec, SceneData, VesselSpec, point_named


def check_names(section: str, items: Sequence[PointSpec | LineSpec | BuoySpec]) -> None:
    """Check that every item of a section has a unique name."""
    names = [item.name for item in items]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise refuse(f"{section}.{i}.name", name, "is used twice", "a unique name")


def check_ends(lines: tuple[LineSpec, ...], points: tuple[PointSpec, ...]) -> None:
    """Check that every line ends at points that exist, and that every point is an end of a line."""
    names = [point.name for point in points]
    for i, line in enumerate(lines):
        for key, name in (("from", line.start), ("to", line.end)):
            if name not in names:
                raise SceneError(f"line.{i}.{key}: {short_text(name)} is not a point; {nearest(name, names)}")
    used = {name for line in lines for name in (line.start, line.end)}
    for i, name in enumerate(names):
        if name not in used and points[i].on is None:
            raise refuse(f"point.{i}.name", name, "is not an end of any line", ", ".join(sorted(used)))


def check_line(line: LineSpec, points: tuple[PointSpec, ...]) -> None:
    check_ends((line,), points)
    start, end = point_named(points, line.start), point_named(points, line.end)
    if start.is_free:
        names = [point.name for point in points]
        raise refuse(
            f"point.{names.index(start.name)}.kind", start.kind, "cannot be the start of a rigid line", "fixed"
        )
    if not end.is_free:
        _check_reach(line, "line.0", start, end)


def _check_reach(line: LineSpec, path: str, start: PointSpec, end: PointSpec) -> None:
    """Check that links between two fixed ends can close: no side of the polygon exceeds the sum of the others."""
    if line.links < 2:
        raise refuse(f"{path}.links", line.links, "leaves no free node between two fixed ends", "a whole number >= 2")
    if not line.rigid:
        return
    distance = check_span(line, path, start, end)
    longest = float(np.max(line.length))
    others = line.total - longest + distance
    if longest >= others:
        raise SceneError(
            f"{path}.length: a link of {longest:g} m cannot be closed by the others and the {distance:g} m between "
            f"the ends; allowed: less than {others:g} m"
        )


def check_system(points: tuple[PointSpec, ...], lines: tuple[LineSpec, ...], buoys: tuple[BuoySpec, ...]) -> None:
    """Check for unique names, elastic lines of one law, every point connected to a fixed one, buoys on free points."""
    check_ends(lines, points)
    check_names("line", lines)
    check_names("buoy", buoys)
    for i, line in enumerate(lines):
        path = f"line.{i}"
        if line.rigid:
            start, end = point_named(points, line.start), point_named(points, line.end)
            if not (start.is_free or end.is_free):
                check_span(line, path, start, end)
        if line.centre_of_mass is not None:
            raise SceneError(
                f"{path}.centre_of_mass: compound links are for single lines only. Remove `centre_of_mass`"
            )
        if line.start == line.end and line.links < 2:
            raise refuse(f"{path}.links", line.links, "leaves no free node in a loop", "a whole number >= 2")
    if not any(point.is_free for point in points) and all(line.links == 1 for line in lines):
        raise refuse("line.0.links", lines[0].links, "leaves no free node between fixed points", "a whole number >= 2")
    _check_connected(points, lines)
    kinds = {point.name: point.kind for point in points}
    for i, buoy in enumerate(buoys):
        if buoy.end_added_mass != buoys[0].end_added_mass:
            path = f"buoy.{i}.end_added_mass"
            raise refuse(path, buoy.end_added_mass, "differs from that of the first buoy", buoys[0].end_added_mass)
    for i, buoy in enumerate(buoys):
        if buoy.point not in kinds:
            raise SceneError(f"buoy.{i}.point: {buoy.point!r} is not a point; {nearest(buoy.point, kinds)}")
        if kinds[buoy.point] != "free":
            raise refuse(f"buoy.{i}.point", buoy.point, "is a fixed point", "a point of kind 'free'")


def check_span(line: LineSpec, path: str, start: PointSpec, end: PointSpec) -> float:
    """The distance [m] between two fixed ends, which rigid links must be able to span."""
    distance = float(np.linalg.norm(end.position - start.position))
    if line.total <= distance:
        raise SceneError(
            f"{path}.length: the links are {line.total:g} m long in all, too short for the {distance:g} m between "
            f"{start.name!r} and {end.name!r}; allowed: more than {distance:g} m in all"
        )
    return distance


def _check_connected(points: tuple[PointSpec, ...], lines: tuple[LineSpec, ...]) -> None:
    reached = {point.name for point in points if not point.is_free or point.on}
    grown = True
    while grown:
        grown = False
        for line in lines:
            if (line.start in reached) != (line.end in reached):
                reached |= {line.start, line.end}
                grown = True
    for i, point in enumerate(points):
        if point.name not in reached:
            raise refuse(
                f"point.{i}.name",
                point.name,
                "is not connected to any fixed point",
                "lines from a point of kind 'fixed'",
            )


def _check_masses(scene: SceneData) -> None:
    """Check that every free point has mass: that of a link, a body or a buoy."""
    nodes = scene.link_mass_nodes
    heavy = {line.end for line in scene.lines} | {line.start for line in scene.lines if nodes[line.name] != "far"}
    heavy |= {buoy.point for buoy in scene.buoys} | {p.name for p in scene.points if p.mass or p.on}
    for i, line in enumerate(scene.lines):
        point = scene.point(line.start)
        if point.is_free and point.name not in heavy:
            why = f"leaves the free point {point.name!r} without mass"
            raise refuse(f"line.{i}.nodes", line.nodes, why, "shared, or the line written from its other end")


def check_system_effects(scene: SceneData) -> None:
    """Check effects that need one line, bodies that need water, and free points that need mass."""
    _check_masses(scene)
    for name in scene.effects:
        if EFFECTS[name].single_line:
            raise SceneError(f"effects.{name}: acts on the nodes of one line; allowed: scenes with one line")
    for i, buoy in enumerate(scene.buoys):
        if scene.sea is None:
            raise SceneError(
                f"buoy.{i}: {buoy.name!r} needs water, but the scene has no [sea]; needed: [sea] with `depth`"
            )


def check_bed(scene: SceneData, pose: tuple[str, np.ndarray] | None) -> None:
    """Check that no point, and no node of a given configuration (its path, and positions (n, 3) [m]), starts below the
    seabed.

    Nodes may be as deep in the seabed as the line is thick: a configuration taken from a run has a small penetration.
    """
    positions = np.array([point.position for point in scene.points])
    bed = bed_height(scene, positions)
    if bed is None:
        return
    # depth below the seabed at which a point may be due to rounding [m]
    for i in np.flatnonzero(positions[:, 2] < bed - 1e-9):
        raise SceneError(
            f"point.{i}.position: z = {positions[i, 2]:g} m is below the seabed; "
            f"allowed: >= {bed[i]:g} m at its x and y"
        )
    if pose is None:
        return
    path, nodes = pose
    bed = bed_height(scene, nodes)
    for i in np.flatnonzero(nodes[:, 2] < bed - np.max(scene.lines[0].diameter)):
        raise SceneError(
            f"{path}: node {i} is at z = {nodes[i, 2]:g} m, below the seabed; allowed: >= {bed[i]:g} m at its x and y"
        )


def motion_warnings(scene: SceneData) -> tuple[str, ...]:
    """A warning if an end starts with a velocity jump, whose tension seabed friction may retain permanently."""
    motion = scene.effects.get("end_motion")
    if motion is None or motion["ramp"] is not None or "seabed_friction" not in scene.effects:
        return ()
    speed = _first_speed(motion)
    # starting speed [m/s] that counts as rest
    if speed <= 1e-6 or not _matters(scene, speed, {motion["point"], *motion["also"]}):
        return ()
    return (
        f"effects.end_motion: {motion['point']} starts abruptly at {speed:.3g} m/s; friction on the seabed may retain "
        "the tension of that shock for the whole run. Use `ramp`",
    )


def _first_speed(motion: dict[str, object]) -> float:
    if motion["time"] is not None:
        time, rows = (np.asarray(motion[key], float) for key in ("time", "displacement"))
        return float(np.linalg.norm(rows[1] - rows[0]) / (time[1] - time[0]))
    phase = 0.0 if motion["phase"] is None else float(motion["phase"])
    return float(np.linalg.norm(motion["amplitude"]) * 2 * np.pi / float(motion["period"]) * abs(np.cos(phase)))


def _matters(scene: SceneData, speed: float, moved: set[str]) -> bool:
    """Whether the tension caused by a start at `speed`, speed times `sqrt(EA m)`, is significant compared with
    `mu w`."""
    friction = scene.effects["seabed_friction"]
    mu = friction["kinetic"] if friction["static"] is None else friction["static"]
    gravity = scene.effects.get("weight", {}).get("gravity", GRAVITY)
    for line in scene.lines:
        if line.start not in moved and line.end not in moved:
            continue
        if line.EA is None:
            return True  # rigid: the shock is unbounded
        weight = float(np.sum(line.mass)) * gravity
        shock = speed * float(np.max(np.sqrt(line.EA * line.mass / line.length)))
        # tension of a shock relative to the friction of the full line below which the tension retained by friction is
        # negligible
        if shock > 0.01 * float(np.max(mu)) * weight:
            return True
    return False


def attached_points(
    bodies: tuple[BodySpec, ...], vessels: tuple[VesselSpec, ...], points: tuple[PointSpec, ...]
) -> tuple[PointSpec, ...]:
    """The bodies' and vessels' attachments as points, at their positions at the start.

    Raises:
        SceneError: a name is used twice.
    """
    check_names("body", bodies)
    check_names("vessel", vessels)
    taken, found = {point.name for point in points}, []
    carriers = [(f"body.{i}", "free", body) for i, body in enumerate(bodies)]
    carriers += [(f"vessel.{i}", "fixed", vessel) for i, vessel in enumerate(vessels)]
    for path, kind, body in carriers:
        for name, position in body.attachments.items():
            if name in taken:
                raise refuse(f"{path}.attachments", name, "is used twice", "unique names among points")
            taken.add(name)
            found.append(PointSpec(name=name, position=body.world(position), kind=kind, on=body.name))
    return tuple(found)


def check_bodies(scene: SceneData) -> None:
    """Check that bodies hang on lines that stretch, and that bodies with shapes are in water."""
    if not scene.bodies:
        return
    for i, line in enumerate(scene.lines):
        if line.rigid:
            raise SceneError(
                f"line.{i}.axial.law: 'rigid' in a scene with bodies. Use lines that stretch, such as 'rope'"
            )
    for i, body in enumerate(scene.bodies):
        if body.shapes and scene.sea is None:
            raise SceneError(
                f"body.{i}: {body.name!r} has cylinders or spheres, but the scene has no [sea]; needed: [sea] with "
                "`depth`, or no shapes"
            )
        if body.touches_bed and ("seabed" not in scene.effects or not body.shapes):
            what = "[effects.seabed]" if body.shapes else "cylinders or spheres"
            raise SceneError(
                f"body.{i}.touches_bed: {body.name!r} lacks {what}; allowed: false, or a body and scene with both"
            )


def body_warnings(scene: SceneData) -> tuple[str, ...]:
    """A warning for each body with attachments away from its shapes: they may be arms of a platform, or a mistake."""
    found = []
    for body in scene.bodies:
        away = body.outside()
        if away:
            name = max(away, key=away.get)
            found.append(
                f"body {body.name!r}: {len(away)} attachments are outside its cylinders and spheres, {name!r} by "
                f"{away[name]:.3g} m; they move with it as if on massless arms"
            )
    return tuple(found)


def check_vessels(scene: SceneData) -> None:
    """Check that a vessel with RAOs has waves that rise from rest, within its table."""
    for i, vessel in enumerate(scene.vessels):
        if vessel.rao is not None and (scene.sea is None or scene.sea.waves is None or scene.sea.ramp is None):
            raise SceneError(
                f"vessel.{i}.rao: needs waves that rise from rest; needed: [sea.waves] and `sea.ramp`, or `motion`"
            )


def check_scene(scene: SceneData) -> None:
    """Check the parts of a scene against each other: effects with bodies, vessels, water and growth."""
    if scene.branched:
        check_system_effects(scene)
        check_bodies(scene)
    check_vessels(scene)
    for effect, values in scene.effects.items():
        if EFFECTS[effect].needs_water or EFFECTS[effect].needs_sea:
            check_water(effect, scene)
        EFFECTS[effect].check(values, scene)
    check_growth(scene)
