"""Elimination of a system of lines in which some links keep their length: tensions stay unknowns beside the places.

    A x + D'(G D x + p y) = r_x,    g . D x + c y = r_y        (c = 0 of rigid links; D takes differences over links)

Along a line each inner node goes with the link before it, four unknowns, in one batched block-tridiagonal elimination.
The last link of each line goes with the points where lines join: it closes the line, as the points do.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.model import Graph
from dropper_jax.solvers.blocks import multiply, solve_tridiagonal
from dropper_jax.solvers.layout import LineRows, line_rows, point_matrix
from dropper_jax.solvers.points import solve_points

#: Compliance of a line's last link, relative to that of its points. It makes no difference but where a straight line
#: between held points leaves nothing to move.
CLOSING = 1e-10


class LinkParts(NamedTuple):
    """Of the links: G (n, 3, 3), p and g (n, 3), c (n,)."""

    turn: jax.Array
    pull: jax.Array
    gradient: jax.Array
    compliance: jax.Array


def solve_saddle(
    graph: Graph, node: jax.Array, links: LinkParts, force: jax.Array, stretch: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Places x (free, 3) and tensions y (n,) for A = `node` (free, 3, 3), r_x = `force`, r_y = `stretch`."""
    diagonal = node + graph.from_first(links.turn) + graph.from_last(links.turn)
    rows, points = line_rows(graph), len(graph.free_points)
    last = np.array([span.stop - 1 for span in graph.spans])
    found = _eliminate_lines(rows, diagonal, links, force, stretch)
    border = _solve_border(graph, rows, found, diagonal[graph.inner :], links, force[graph.inner :], stretch)
    at_points, closing = border[:points], border[points:, 0]
    y = jnp.zeros_like(stretch).at[last].set(closing)
    if not rows.nodes.size:
        return at_points, y
    padded = jnp.concatenate([at_points, jnp.zeros((1, 3), force.dtype)])  # held points do not move
    long = closing[np.flatnonzero([m.links > 1 for m in graph.members])]
    given = jnp.concatenate([padded[rows.start], padded[rows.end], long[:, None]], axis=-1)
    moved = found[..., 0] + multiply(found[..., 1:], given[:, None, :, None])[..., 0]
    inner = moved.reshape(-1, 4)[rows.position]
    return jnp.concatenate([inner[:, :3], at_points]), y.at[graph.before].set(inner[:, 3])


def _eliminate_lines(
    rows: LineRows, diagonal: jax.Array, links: LinkParts, force: jax.Array, stretch: jax.Array
) -> jax.Array:
    """Inner nodes and the links before them (lines, m, 4, 8): under their loads, for unit moves of the start and of the
    end, and for a unit tension of the last link."""
    if not rows.nodes.size:
        return jnp.zeros((0, 0, 4, 8), force.dtype)
    real, first, last = (a[..., None, None] for a in (rows.real, rows.first, rows.last))
    before, after = rows.link_before, rows.link_before + 1

    def block(top: jax.Array, right: jax.Array, below: jax.Array, corner: jax.Array) -> jax.Array:
        upper = jnp.concatenate([top, right[..., None]], axis=-1)
        return jnp.concatenate([upper, jnp.concatenate([below, corner[..., None]], axis=-1)[..., None, :]], axis=-2)

    turn, pull, gradient, compliance = (x[before] for x in links)
    none, nothing = jnp.zeros_like(pull), jnp.zeros_like(compliance)
    inner = jnp.where(real, block(diagonal[rows.nodes], pull, gradient, compliance), jnp.eye(4, dtype=force.dtype))
    from_start = block(turn, none, gradient, nothing)
    lower = jnp.where(real & ~first, -from_start, 0.0)
    from_end = block(links.turn[after], links.pull[after], none, nothing)
    upper = jnp.where(real & ~last, -from_end, 0.0)
    load = jnp.concatenate([force[rows.nodes], stretch[before][..., None]], axis=-1)[..., None]
    columns = [jnp.where(real, load, 0.0), jnp.where(first, from_start[..., :3], 0.0), jnp.where(last, from_end, 0.0)]
    return solve_tridiagonal(lower, inner, upper, jnp.concatenate(columns, axis=-1))


def _solve_border(
    graph: Graph,
    rows: LineRows,
    found: jax.Array,
    diagonal: jax.Array,
    links: LinkParts,
    force: jax.Array,
    stretch: jax.Array,
) -> jax.Array:
    """Moves of the free points and, as first components of as many more rows, tensions of the lines' last links."""
    table = point_matrix(graph, tensions=True)
    last = np.array([span.stop - 1 for span in graph.spans])
    long = np.flatnonzero([m.links > 1 for m in graph.members])
    # rows of the last links, by moves of start and end and their own tension; what their tension does to both points
    by_start, by_end, own = -links.gradient[last], links.gradient[last], links.compliance[last]
    to_start, to_end = -links.pull[last], links.pull[last]
    rest, pairs = stretch[last], []
    if rows.nodes.size:
        first, final = rows.first_link, rows.last_link
        near, far = found[:, 0], found[np.arange(len(long)), rows.last_row]
        # what the first and the last link of a line pull at its points when its inner nodes move
        pushed = multiply(links.turn[first], near[:, :3]) + links.pull[first][..., None] * near[:, 3:]
        pulled = multiply(links.turn[final], far[:, :3])
        closed = jnp.sum(links.gradient[final][..., None] * far[:, :3], axis=-2)
        by_start, by_end = by_start.at[long].set(-closed[:, 1:4]), by_end.at[long].add(-closed[:, 4:7])
        own, rest = own.at[long].add(-closed[:, 7]), rest.at[long].add(closed[:, 0])
        to_start, to_end = to_start.at[long].set(-pushed[..., 7]), to_end.at[long].add(-pulled[..., 7])
        pairs = [-pushed[..., 1:4], -pushed[..., 4:7], -pulled[..., 1:4], -pulled[..., 4:7]]
        at_start, at_end = table.start_lines, table.end_lines
        force = force.at[rows.start[at_start]].add(pushed[at_start, :, 0])
        force = force.at[rows.end[at_end]].add(pulled[at_end, :, 0])
    size = jnp.max(jnp.abs(diagonal)) if len(diagonal) else jnp.max(jnp.abs(links.turn)) + 1.0
    unit = jnp.eye(3, dtype=force.dtype)
    corner = unit[0][:, None] * unit[0]
    tension = unit - corner + (own - CLOSING / size)[:, None, None] * corner
    column = lambda v: v[..., None] * unit[0]  # noqa: E731  a tension stands in the first of three components
    row = lambda v: unit[0][:, None] * v[..., None, :]  # noqa: E731
    direct = -links.turn[table.direct]
    beside = [column(to_start), row(by_start), column(to_end), row(by_end)]
    values = [diagonal, tension, direct, direct, *pairs, *beside]
    load = jnp.concatenate([force, rest[:, None] * unit[0]])
    return solve_points(table, values, load)
