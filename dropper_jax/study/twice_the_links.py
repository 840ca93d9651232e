"""A scene with twice the links, to measure the error due to their number."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Plain, Table, declared_fields
from dropper_jax.base.records import without_keys
from dropper_jax.effects import EFFECTS
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.scene import LineSpec
from dropper_jax.scene.start import rows_of_pieces

#: Units of the quantities of a link or a node that are divided between its halves; all others are equal.
DIVIDED_UNITS = ("N", "kg", "kg/s", "kg/m")
#: Quantities of a line per link, and the divisor that gives those of each half.
PER_LINK = {"length": 2, "mass": 2, "diameter": 1, "outer_diameter": 1, "breaking_load": 1}


def twice_the_links(scene: Scene) -> Scene:
    """The scene with each link divided into halves; axial stiffness and internal damping do not change.

    Raises:
        SceneError: unsupported scenes: compound links, a single rigid link, joint friction, a link inside a line whose
            length changes in time.
    """
    if any(line.centre_of_mass is not None for line in scene.lines):
        raise SceneError("line.centre_of_mass: compound links have no halves; allowed: lines of simple links")
    if all(line.rigid and line.links == 1 for line in scene.lines):
        raise SceneError("line.links: a single rigid link is the body itself; allowed: lines of several links")
    if "joint_friction" in scene.effects:
        raise SceneError("effects.joint_friction: depends on the number of joints. Use a scene without it")
    table = scene.to_dict()
    table["line"] = list(map(_refine_line, table["line"]))
    table["effects"] = {name: _refine_effect(name, values) for name, values in table["effects"].items()}
    table["start"] = _refine_start(table["start"], scene.lines)
    for failure in table.get("failure", ()):
        if failure.get("link") is not None:
            failure["link"] = 2 * failure["link"] - 1
    return load_scene(table)


def _refine_line(line: Table) -> Table:
    """A line of a scene with twice the links."""
    halves = {key: _halve_value(line[key], parts) for key, parts in PER_LINK.items() if key in line}
    if "axial" in line:
        halves["axial"] = _refine_axial(line["axial"])
    if "length_in_time" in line:
        halves["length_in_time"] = [_refine_length_in_time(item, line["links"]) for item in line["length_in_time"]]
    return {**line, **halves, "links": 2 * line["links"]}


def _refine_length_in_time(item: Table, links: int) -> Table:
    """Both halves of the links whose total length changes in time, of a line with this number of links."""
    ends = {1: "from", links: "to"}
    link = item.get("link")
    if link is None:
        return {**item, "links": 2 * (item.get("links") or 1)}
    if link not in ends:
        raise SceneError(f"line.length_in_time.link: {link} has no halves; allowed: links at an end of the line")
    return {**without_keys(item, ["link"]), "end": ends[link], "links": 2}


def _refine_axial(axial: Table) -> Table:
    """An axial law with twice the links: a table of tensions is one list for all links, or a list for each."""
    refined = {}
    for key, value in axial.items():
        if key in ("strain", "tension"):
            if isinstance(value[0], list):
                value = [rows for rows in value for _ in (0, 1)]
            refined[key] = value
        else:
            refined[key] = _halve_value(value, 1)
    return refined


def _refine_effect(name: str, values: Table) -> Table:
    """An effect of a scene with twice the links: values per link or node, and numbers of nodes."""
    refined = dict(values)
    for field in declared_fields(EFFECTS[name]).values():
        key = field.name
        if refined.get(key) is not None and field.metadata.get("shape") in ("link", "node"):
            parts = 2 if field.metadata.get("unit") in DIVIDED_UNITS else 1
            refined[key] = _halve_value(refined[key], parts)
    for key in ("node", "nodes"):  # of one line, counted from 1
        if refined.get(key) is not None and isinstance(refined[key], list | int) and not isinstance(refined[key], bool):
            refined[key] = (2 * np.asarray(refined[key])).tolist()
    return refined


def _refine_start(start: Table, lines: Sequence[LineSpec]) -> Table:
    """The start of a scene with twice the links: new nodes are in the middle of the links of these lines."""
    refined = dict(start)
    for key in ("polar", "azimuth", "polar_rate", "azimuth_rate"):
        if refined.get(key) is not None:
            refined[key] = np.repeat(refined[key], 2).tolist()
    for key in ("positions", "velocities"):
        if refined.get(key) is not None:
            given = np.asarray(refined[key], float)
            ends = _first_rows_of_links(lines)
            middles = 0.5 * (given[ends] + given[ends + 1])
            refined[key] = np.insert(given, ends + 1, middles, axis=0).tolist()
    if refined.get("release_nodes") is not None:
        refined["release_nodes"] = [2 * node for node in refined["release_nodes"]]
    return refined


def _first_rows_of_links(lines: Sequence[LineSpec]) -> np.ndarray:
    """The row of the first node of each link in the list of the nodes of all lines."""
    rows = rows_of_pieces(lines)
    found = []
    first = 0
    for line in lines:
        found += rows[first : first + line.links].tolist()
        first += line.links + 1
    return np.array(found)


def _halve_value(value: Plain, parts: int) -> Plain:
    """Value of each half of a link, from a number or a list of one per link; a text is unchanged."""
    if isinstance(value, list):
        return np.repeat(np.asarray(value, float) / parts, 2).tolist()
    if isinstance(value, int | float):
        return value / parts
    return value
