"""Where each line of a scene, and each line as the user wrote it, is in arrays of all nodes and all links."""

from __future__ import annotations

from itertools import groupby
from typing import NamedTuple

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.scene.data import SceneData
from dropper_jax.scene.line import LineSpec, join_lines


class LineSlice(NamedTuple):
    """Index ranges of one line of a scene in a solution's arrays: its nodes, both ends included, and its links."""

    name: str
    nodes: slice
    links: slice


class WholeLine(NamedTuple):
    """A line as the user wrote it, with the pieces between its attached points combined.

    Attributes:
        name: of the line.
        spec: its values, one per link.
        nodes: indices of its nodes (links + 1,), each joint once.
        links: indices of its links.
        stops: names of the points along it by node, both ends included.
        pieces: number of the scene's lines of which it is made.
    """

    name: str
    spec: LineSpec
    nodes: np.ndarray
    links: slice
    stops: dict[int, str]
    pieces: int


def line_slices(scene: SceneData) -> tuple[LineSlice, ...]:
    """Index ranges of the lines of a scene in arrays of all nodes and of all links."""
    found = []
    start = 0
    for i, line in enumerate(scene.lines):
        end = start + line.links
        found.append(LineSlice(line.name, slice(start + i, end + i + 1), slice(start, end)))
        start = end
    return tuple(found)


def first_nodes(scene: SceneData) -> np.ndarray:
    """First node of each link (n,); the next node is its last."""
    return np.concatenate([np.arange(line.nodes.start, line.nodes.stop - 1) for line in line_slices(scene)])


def link_differences(scene: SceneData, nodal: np.ndarray) -> np.ndarray:
    """Values at the last node of each link less those at its first (k, n, ...), from those of all nodes."""
    first = first_nodes(scene)
    return nodal[:, first + 1] - nodal[:, first]


def sliced_lines(scene: SceneData) -> list[tuple[LineSpec, LineSlice]]:
    """The lines of a scene, each with its index ranges."""
    return list(zip(scene.lines, line_slices(scene), strict=True))


def point_nodes(scene: SceneData) -> dict[str, int]:
    """By name of a point, the first node of the lines' arrays at that point."""
    found: dict[str, int] = {}
    for line, where in sliced_lines(scene):
        found.setdefault(line.start, where.nodes.start)
        found.setdefault(line.end, where.nodes.stop - 1)
    return found


def line_offsets(scene: SceneData) -> list[Table]:
    """`line_slices` as plain values: index of the first node and link of each line, and its number of links."""
    found = []
    for line, where in sliced_lines(scene):
        first = {"first_node": where.nodes.start, "first_link": where.links.start}
        found.append({"name": line.name, **first, "links": line.links})
    return found


def whole_lines(scene: SceneData) -> tuple[WholeLine, ...]:
    """The lines of a scene as the user wrote them."""
    groups = groupby(sliced_lines(scene), key=lambda pair: (pair[0].piece_of, pair[0].piece_of or pair[0].name))
    return tuple(_merge_pieces(list(group)) for _, group in groups)


def _merge_pieces(group: list[tuple[LineSpec, LineSlice]]) -> WholeLine:
    """One line of its pieces, each with its index ranges."""
    specs, slices = zip(*group, strict=True)
    nodes = [np.arange(where.nodes.start + (i > 0), where.nodes.stop) for i, where in enumerate(slices)]
    links = slice(slices[0].links.start, slices[-1].links.stop)
    stops = {0: specs[0].start}
    for spec, where in group:
        stops[where.links.stop - links.start] = spec.end
    name = specs[0].name
    if len(group) > 1:
        name = specs[0].piece_of
    return WholeLine(name, join_lines(specs), np.concatenate(nodes), links, stops, len(group))
