"""Position of a sensor on a scene's lines: a line's node, link, end or length along it, or a point of the scene."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.scene import SceneData, WholeLine, whole_lines

#: Relative rounding of a line's length, which is a sum of links.
ROUNDING = 1e-9


class Node(NamedTuple):
    """A position between nodes `first` and `second` of all nodes, at the fraction `share` [-]."""

    first: int
    second: int
    share: float


class Where(NamedTuple):
    """Entries of a channel's table that give the position of its sensor; missing ones are empty."""

    line: str | None = None
    link: int | None = None
    node: int | None = None
    end: str | None = None
    at: float | None = None
    point: str | None = None


def line_of(scene: SceneData, name: str | None, path: str) -> WholeLine:
    """The line of this name as specified; a scene with one line needs no name.

    Raises:
        SceneError: no such line.
    """
    lines = whole_lines(scene)
    if name is None and len(lines) == 1:
        return lines[0]
    known = [line.name for line in lines]
    if name not in known:
        raise SceneError(f"{path}.line: {name!r} is not a line of the scene; {nearest(str(name), known)}")
    return lines[known.index(name)]


def node_of(scene: SceneData, where: Where, path: str) -> Node:
    """The position of a sensor on a node, at a point, or at a length along a line.

    Raises:
        SceneError: no position or more than one; a node, point or length that the line does not have.
    """
    _one_of(where, ("node", "end", "at", "point"), path)
    if where.point is not None:
        node = ends_at(scene, where.point, path)[0][0]
        return Node(node, node, 0.0)
    line = line_of(scene, where.line, path)
    if where.at is not None:
        total = np.concatenate([[0.0], np.cumsum(line.spec.length)])
        _inside(where.at, total[-1], line.name, path)
        link = int(np.clip(np.searchsorted(total, where.at, side="right") - 1, 0, line.spec.links - 1))
        share = (where.at - total[link]) / line.spec.length[link]
        return Node(int(line.nodes[link]), int(line.nodes[link + 1]), float(share))
    if where.node is not None:
        number = where.node
    else:
        number = _end(where.end, 0, line.spec.links, path)
    if not 0 <= number <= line.spec.links:
        raise SceneError(
            f"{path}.node: {number} is outside line {line.name!r}; allowed: 0 (its first point) to {line.spec.links}"
        )
    return Node(int(line.nodes[number]), int(line.nodes[number]), 0.0)


def link_of(scene: SceneData, where: Where, path: str) -> int:
    """Number, from 0 among all links, of the link that carries a sensor.

    Raises:
        SceneError: no position or more than one; a link or length that the line does not have.
    """
    _one_of(where, ("link", "end", "at"), path)
    line = line_of(scene, where.line, path)
    if where.at is not None:
        total = np.cumsum(line.spec.length)
        _inside(where.at, total[-1], line.name, path)
        number = int(np.searchsorted(total, where.at - 1e-12)) + 1
    elif where.link is not None:
        number = where.link
    else:
        number = _end(where.end, 1, line.spec.links, path)
    if not 1 <= number <= line.spec.links:
        raise SceneError(f"{path}.link: {number} is outside line {line.name!r}; allowed: 1 to {line.spec.links}")
    return line.links.start + number - 1


def ends_at(scene: SceneData, point: str, path: str) -> tuple[tuple[int, int, int], ...]:
    """For every line that ends at a point: its node there, the next one, and the link between.

    Raises:
        SceneError: no such point.
    """
    found = tuple(
        (int(line.nodes[node]), int(line.nodes[inner]), line.links.start + min(node, inner))
        for line in whole_lines(scene)
        for node, name in line.stops.items()
        for inner in (node + 1, node - 1)
        if name == point and 0 <= inner <= line.spec.links
    )
    if not found:
        raise SceneError(
            f"{path}.point: {point!r} is not a point of the scene; {nearest(point, [p.name for p in scene.points])}"
        )
    return found


def _end(end: str | None, first: int, last: int, path: str) -> int:
    if end not in ("from", "to"):
        raise SceneError(f"{path}.end: {end!r} is not an end of a line; allowed: from, to")
    if end == "from":
        return first
    return last


def _inside(at: float, length: float, line: str, path: str) -> None:
    if not 0 <= at <= length * (1.0 + ROUNDING):
        raise SceneError(f"{path}.at: {at:g} m is outside line {line!r}; allowed: 0 to {length:g} m")


def _one_of(where: Where, keys: tuple[str, ...], path: str) -> None:
    """Reject a position that is missing, given twice, or given by a key that this kind does not support."""
    given = [key for key in ("link", "node", "end", "at", "point") if getattr(where, key) is not None]
    wrong = [key for key in given if key not in keys]
    if wrong:
        raise SceneError(f"{path}.{wrong[0]}: not a position for this kind of sensor; allowed: {', '.join(keys)}")
    if len(given) != 1:
        if not given:
            what = "position missing"
        else:
            what = f"position given twice, by {' and '.join(given)}"
        raise SceneError(f"{path}: {what}; allowed: one of {', '.join(keys)}")
