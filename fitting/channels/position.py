"""Position of a sensor on a scene's lines: a line's node, link, end or length along it, or a point of the scene."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Values, read_integer, read_number, read_text
from dropper_jax.scene import SceneData, WholeLine, whole_lines

#: Relative rounding of a line's length, which is a sum of links.
LENGTH_ROUNDING = 1e-9


class Node(NamedTuple):
    """A position between nodes `first` and `second` of all nodes, at the fraction `share` [-]."""

    first: int
    second: int
    share: float


def find_line(scene: SceneData, table: Values, path: str) -> WholeLine:
    """The line that a channel's table names, as specified; a scene with one line needs no name.

    Raises:
        SceneError: no such line.
    """
    lines = {line.name: line for line in whole_lines(scene)}
    name = None
    if "line" in table:
        name = read_text(table["line"], f"{path}.line")
    elif len(lines) == 1:
        (name,) = lines
    if name not in lines:
        raise SceneError(f"{path}.line: {name!r} is not a line of the scene; {nearest(str(name), lines)}")
    return lines[name]


def find_node(scene: SceneData, table: Values, path: str) -> Node:
    """The position of a sensor on a node, at a point, or at a length along a line.

    Raises:
        SceneError: no position or more than one; a node, point or length that the line does not have.
    """
    key = _one_of(table, ("node", "end", "at", "point"), path)
    if key == "point":
        node = ends_at(scene, read_text(table["point"], f"{path}.point"), path)[0][0]
        return Node(node, node, 0.0)
    line = find_line(scene, table, path)
    links = line.spec.links
    if key == "at":
        at = _length_along(table, line, path)
        link = min(int(np.searchsorted(np.cumsum(line.spec.length), at, side="right")), links - 1)
        return Node(int(line.nodes[link]), int(line.nodes[link + 1]), share_of_link(line, link, at))
    if key == "node":
        number = read_integer(table["node"], f"{path}.node")
    else:
        number = _end(table, 0, links, path)
    if not 0 <= number <= links:
        raise SceneError(
            f"{path}.node: {number} is outside line {line.name!r}; allowed: 0 (its first point) to {links}"
        )
    return Node(int(line.nodes[number]), int(line.nodes[number]), 0.0)


def share_of_link(line: WholeLine, link: int, at: float) -> float:
    """The fraction [-] of a link, from its first node, at a length [m] along its line."""
    ends = np.concatenate([[0.0], np.cumsum(line.spec.length)])
    return float((at - ends[link]) / line.spec.length[link])


def find_link(scene: SceneData, table: Values, path: str) -> tuple[WholeLine, int]:
    """The line and the number in it, from 0, of the link that carries a sensor; at a node the link before it.

    Raises:
        SceneError: no position or more than one; a link or length that the line does not have.
    """
    key = _one_of(table, ("link", "end", "at"), path)
    line = find_line(scene, table, path)
    if key == "at":
        at = _length_along(table, line, path)
        ends = np.cumsum(line.spec.length)
        number = int(np.searchsorted(ends, at - LENGTH_ROUNDING * ends[-1])) + 1
    elif key == "link":
        number = read_integer(table["link"], f"{path}.link")
    else:
        number = _end(table, 1, line.spec.links, path)
    if not 1 <= number <= line.spec.links:
        raise SceneError(f"{path}.link: {number} is outside line {line.name!r}; allowed: 1 to {line.spec.links}")
    return line, number - 1


def ends_at(scene: SceneData, point: str, path: str) -> tuple[tuple[int, int, int], ...]:
    """For every line that ends at a point: its node there, the next one, and the link between.

    Raises:
        SceneError: no such point.
    """
    found = []
    for line in whole_lines(scene):
        for node, name in line.stops.items():
            for inner in (node + 1, node - 1):
                if name == point and 0 <= inner <= line.spec.links:
                    found.append((int(line.nodes[node]), int(line.nodes[inner]), line.links.start + min(node, inner)))
    if not found:
        known = [p.name for p in scene.points]
        raise SceneError(f"{path}.point: {point!r} is not a point of the scene; {nearest(point, known)}")
    return tuple(found)


def _end(table: Values, first: int, last: int, path: str) -> int:
    """The number of the node or link at the `end` of a line, of numbers from `first` to `last`."""
    numbers = {"from": first, "to": last}
    end = read_text(table["end"], f"{path}.end")
    if end not in numbers:
        raise SceneError(f"{path}.end: {end!r} is not an end of a line; allowed: from, to")
    return numbers[end]


def _length_along(table: Values, line: WholeLine, path: str) -> float:
    """The length [m] along a line from its first point, at the key `at`; at most that of the line."""
    at = read_number(table["at"], f"{path}.at", {"unit": "m"})
    length = float(np.cumsum(line.spec.length)[-1])
    if not 0 <= at <= length * (1.0 + LENGTH_ROUNDING):
        raise SceneError(f"{path}.at: {at:g} m is outside line {line.name!r}; allowed: 0 to {length:g} m")
    return min(at, length)


def _one_of(table: Values, keys: tuple[str, ...], path: str) -> str:
    """The key that gives the position; rejects one that is missing, given twice, or that this kind does not support."""
    given = [key for key in ("link", "node", "end", "at", "point") if key in table]
    wrong = [key for key in given if key not in keys]
    if wrong:
        raise SceneError(f"{path}.{wrong[0]}: not a position for this kind of sensor; allowed: {', '.join(keys)}")
    if len(given) != 1:
        what = "position missing"
        if given:
            what = f"position given twice, by {' and '.join(given)}"
        raise SceneError(f"{path}: {what}; allowed: one of {', '.join(keys)}")
    return given[0]
