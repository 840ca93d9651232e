"""Static tables of the network solver: lines as padded rows, and where each piece goes in the matrix of the points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dropper_jax.model import Graph

#: Up to this many free points their matrix is solved as one dense block; LU of 36 rows costs less than the rounds of
#: block elimination.
DENSE_POINTS = 12


@dataclass(frozen=True)
class LineRows:
    """Lines with inner nodes, padded to the longest: (lines, m) tables, and (lines,) per line.

    Attributes:
        nodes, real: free node numbers, and which entries are nodes at all.
        link_before: link before each node; the one after it is the next.
        first, last: which entries are the first and the last node of their line.
        position: where each inner node (inner,) stands in the flattened table.
        start, end: free points at the ends; the number of free points where held.
        first_link, last_link, last_row: per line.
    """

    nodes: np.ndarray
    real: np.ndarray
    link_before: np.ndarray
    first: np.ndarray
    last: np.ndarray
    position: np.ndarray
    start: np.ndarray
    end: np.ndarray
    first_link: np.ndarray
    last_link: np.ndarray
    last_row: np.ndarray


@dataclass(frozen=True)
class PointMatrix:
    """Blocks of `width` points, `blocks` of them, in an order of small bandwidth.

    Attributes:
        order: slot of each free point, and of what stands beside them.
        entry: where each contribution goes among the flattened (blocks, 3, width, width) entries, for those kept.
        kept: numbers of the contributions that lie between free points.
        unused: slots without a point.
        direct: links that join two points without inner nodes.
        start_lines, end_lines: lines (rows of `LineRows`) that begin and end at a free point.
    """

    order: np.ndarray
    width: int
    blocks: int
    entry: np.ndarray
    kept: np.ndarray
    unused: np.ndarray
    direct: np.ndarray
    start_lines: np.ndarray
    end_lines: np.ndarray


@lru_cache(maxsize=64)
def line_rows(graph: Graph) -> LineRows:
    long = [i for i, m in enumerate(graph.members) if m.links > 1]
    counts = np.array([graph.members[i].links - 1 for i in long], int)
    most = int(counts.max(initial=0))
    column = np.arange(most)[None, :]
    real = column < counts[:, None]
    begin = np.cumsum([0, *(m.links - 1 for m in graph.members)])[long].astype(int)
    link = np.array([graph.spans[i].start for i in long], int)
    free_number = np.full(len(graph.held), len(graph.free_points))
    free_number[graph.free_points] = np.arange(len(graph.free_points))
    position = np.concatenate([row * most + np.arange(c) for row, c in enumerate(counts)] or [np.zeros(0)]).astype(int)
    return LineRows(
        nodes=np.where(real, begin[:, None] + column, 0),
        real=real,
        link_before=np.where(real, link[:, None] + column, 0),
        first=(column == 0) & real,
        last=(column == counts[:, None] - 1) & real,
        position=position,
        start=free_number[[graph.members[i].start for i in long]] if long else np.zeros(0, int),
        end=free_number[[graph.members[i].end for i in long]] if long else np.zeros(0, int),
        first_link=link,
        last_link=link + counts,
        last_row=counts - 1,
    )


@lru_cache(maxsize=64)
def point_matrix(graph: Graph, tensions: bool = False) -> PointMatrix:
    """Of the free points; with `tensions` also of the last link of each line, which counts as a point after them."""
    rows = line_rows(graph)
    points = len(graph.free_points)
    count = points + len(graph.members) * tensions
    number = np.full(len(graph.held), count)
    number[graph.free_points] = np.arange(points)
    short = [i for i, m in enumerate(graph.members) if m.links == 1]
    start, end = (number[[getattr(m, key) for m in graph.members]] for key in ("start", "end"))
    long = [i for i, m in enumerate(graph.members) if m.links > 1]
    a, b = start[long], end[long]
    own, last = np.arange(count), np.arange(points, count)
    beside = [start, last, end, last] if tensions else []
    # contributions in the order in which solvers list them: own blocks, direct links both ways, lines (ss, se, es, ee),
    # last links (sy, ys, ey, ye)
    row = np.concatenate([own, start[short], end[short], a, a, b, b, *beside]).astype(int)
    turned = [last, start, last, end] if tensions else []
    column = np.concatenate([own, end[short], start[short], a, b, a, b, *turned]).astype(int)
    kept = np.flatnonzero((row < count) & (column < count))
    row, column = row[kept], column[kept]
    order, width = _order(row, column, count)
    blocks = -(-count // width)
    place, other = order[row], order[column]
    offset = other // width - place // width + 1
    entry = ((place // width * 3 + offset) * width + place % width) * width + other % width
    return PointMatrix(
        order=order,
        width=width,
        blocks=blocks,
        entry=entry,
        kept=kept,
        unused=np.arange(count, blocks * width),
        direct=np.array([graph.spans[i].start for i in short], int),
        start_lines=np.flatnonzero(rows.start < points),
        end_lines=np.flatnonzero(rows.end < points),
    )


def _order(row: np.ndarray, column: np.ndarray, count: int) -> tuple[np.ndarray, int]:
    """Slot of each point, and the points per block, so that blocks couple to their neighbours only."""
    if count <= DENSE_POINTS:
        return np.arange(count), max(count, 1)
    # asked for by systems of many points only: reading a scene does not wait for it
    from scipy.sparse import coo_array  # noqa: PLC0415
    from scipy.sparse.csgraph import reverse_cuthill_mckee  # noqa: PLC0415

    pattern = coo_array((np.ones(len(row)), (row, column)), shape=(count, count)).tocsr()
    slot = np.empty(count, int)
    slot[reverse_cuthill_mckee(pattern, symmetric_mode=True)] = np.arange(count)
    width = int(np.max(np.abs(slot[row] - slot[column]), initial=1))
    return slot, count if 2 * width >= count else width
