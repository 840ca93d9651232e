"""Index ranges of the lines of a scene in arrays of all nodes and of all links."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

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
    found, node, link = [], 0, 0
    for line in scene.lines:
        nodes = slice(node, node + line.links + 1)
        found.append(LineSlice(line.name, nodes, slice(link, link + line.links)))
        node, link = nodes.stop, link + line.links
    return tuple(found)


def line_offsets(scene: SceneData) -> list[dict[str, Any]]:
    """The same as plain values: index of the first node and link of each line in the arrays, and its number of
    links."""
    return [
        {
            "name": w.name,
            "first_node": w.nodes.start,
            "first_link": w.links.start,
            "links": w.links.stop - w.links.start,
        }
        for w in line_slices(scene)
    ]


def whole_lines(scene: SceneData) -> tuple[WholeLine, ...]:
    """The lines of a scene as the user wrote them."""
    groups: list[list[tuple[LineSpec, LineSlice]]] = []
    for pair in zip(scene.lines, line_slices(scene), strict=True):
        last = groups[-1][-1][0] if groups else None
        if last is not None and last.piece_of is not None and last.piece_of == pair[0].piece_of:
            groups[-1].append(pair)
        else:
            groups.append([pair])
    return tuple(_merge_pieces(group) for group in groups)


def _merge_pieces(group: list[tuple[LineSpec, LineSlice]]) -> WholeLine:
    specs, slices = [spec for spec, _ in group], [where for _, where in group]
    nodes = [np.arange(where.nodes.start + (i > 0), where.nodes.stop) for i, where in enumerate(slices)]
    ends = np.cumsum([spec.links for spec in specs])
    stops = {0: specs[0].start, **{int(end): spec.end for end, spec in zip(ends, specs, strict=True)}}
    name = specs[0].name if len(group) == 1 else specs[0].piece_of
    links = slice(slices[0].links.start, slices[-1].links.stop)
    return WholeLine(name, join_lines(tuple(specs)), np.concatenate(nodes), links, stops, len(group))


def held_loads(scene: SceneData, positions: np.ndarray, tension: np.ndarray) -> dict[str, np.ndarray]:
    """Force of the lines on each fixed point (3,) [N] in a configuration: `T d/|d|` of the links that end there, d
    outwards."""
    loads = {point.name: np.zeros(3) for point in scene.points if point.kind == "fixed"}
    for line, where in zip(scene.lines, line_slices(scene), strict=True):
        first, last = where.nodes.start, where.nodes.stop - 1
        ends = ((line.start, first, first + 1, where.links.start), (line.end, last, last - 1, where.links.stop - 1))
        for point, node, inner, link in ends:
            if point in loads:
                along = positions[inner] - positions[node]
                loads[point] = loads[point] + tension[link] * along / max(float(np.linalg.norm(along)), 1e-300)
    return loads
