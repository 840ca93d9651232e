"""Consistency of lines and points: ends that exist, and the requirements of a system of several lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import refuse, short_text
from dropper_jax.effects import EFFECTS
from dropper_jax.load.surroundings import bed_height
from dropper_jax.scene import BuoySpec, LineSpec, PointSpec, SceneData, point_named

#: Depth below the seabed at which a point may be due to rounding [m].
ROUNDING = 1e-9


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


def check_system(points: tuple[PointSpec, ...], lines: tuple[LineSpec, ...], buoys: tuple[BuoySpec, ...]) -> None:
    """Check for unique names, elastic lines of one law, every point connected to a fixed one, buoys on free points."""
    check_ends(lines, points)
    check_names("line", lines)
    check_names("buoy", buoys)
    for i, line in enumerate(lines):
        path = f"line.{i}"
        if line.rigid:
            start, end = point_named(points, line.start), point_named(points, line.end)
            if start.kind == end.kind == "fixed":
                check_span(line, path, start, end)
        if line.centre_of_mass is not None:
            raise SceneError(
                f"{path}.centre_of_mass: compound links are for single lines only. Remove `centre_of_mass`"
            )
        if line.start == line.end and line.links < 2:
            raise refuse(f"{path}.links", line.links, "leaves no free node in a loop", "a whole number >= 2")
    if all(point.kind == "fixed" for point in points) and all(line.links == 1 for line in lines):
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
    reached = {point.name for point in points if point.kind == "fixed" or point.on}
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
        if point.kind == "free" and point.name not in heavy:
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
    for i in np.flatnonzero(positions[:, 2] < bed - ROUNDING):
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
