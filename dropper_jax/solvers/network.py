"""The exact Jacobian of a system of lines: tensions and friction on their own nodes first, then the lines' inner nodes
in one batched block-tridiagonal elimination, then the points where lines join.

    node rows:  A dx + D'(G D dx + p dy) = r_x,    link rows:  g . D dx + c dy = r_y

D takes differences over links. With `dy = (r_y - g . D dx)/c` a link is a 3x3 stiffness `S = G - p g'/c` between its
nodes; where some links are rigid (c = 0) tensions stay unknowns, see `saddle`. Unknowns of node-local laws (seabed
friction) go before all others, softened by `SOFT` where the law holds its node: there the matrix is approximate, and
Newton still ends at the exact solution.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.model import Graph, Model
from dropper_jax.residual import Implicit, StepProblem, Unknowns, node_blocks
from dropper_jax.solvers.blocks import multiply, solve_tridiagonal
from dropper_jax.solvers.layout import LineRows, line_rows, point_matrix
from dropper_jax.solvers.points import solve_points
from dropper_jax.solvers.saddle import LinkParts, solve_saddle

#: Compliance of a held node's friction relative to its inertia.
SOFT = 1e-8


class LawBlocks(NamedTuple):
    """A node-local law in the Jacobian: force rows by z (free, 3, 2), its rows by x (free, 2, 3) and z (free, 2, 2)."""

    force: jax.Array
    place: jax.Array
    own: jax.Array


@dataclass(frozen=True)
class NetworkParts:
    """The Jacobian in pieces: A (free, 3, 3), the links', and the law's blocks or None; whether all links stretch."""

    node: jax.Array
    links: LinkParts
    law: LawBlocks | None
    elastic: bool

    def transposed(self) -> NetworkParts:
        flip = lambda a: jnp.swapaxes(a, -1, -2)  # noqa: E731
        law = None if self.law is None else LawBlocks(flip(self.law.place), flip(self.law.force), flip(self.law.own))
        turn, pull, gradient, compliance = self.links
        return replace(self, node=flip(self.node), links=LinkParts(flip(turn), gradient, pull, compliance), law=law)


def _column(x: jax.Array) -> jax.Array:
    return x[..., None]


def _inverse2(m: jax.Array) -> jax.Array:
    a, b, c, d = m[..., 0, 0], m[..., 0, 1], m[..., 1, 0], m[..., 1, 1]
    rows = jnp.stack([jnp.stack([d, -b], axis=-1), jnp.stack([-c, a], axis=-1)], axis=-2)
    return rows / (a * d - b * c)[..., None, None]


@dataclass(frozen=True)
class Network:
    """Lines batched, then points."""

    name: str = "network"

    def refuse(self, model: Model, integrator: Implicit) -> str | None:
        if not isinstance(model.geometry, Graph):
            return "it is for systems of lines, but the scene is one line; use condensed, banded or dense"
        if not integrator.networkable:
            return f"integrator {integrator.name!r} does not offer the pieces it needs; use dense"
        if model.reach > 0:
            return "a force in the scene couples neighbouring nodes beside the tensions; use dense"
        if len(model.laws) > 1 or any(not law.node_local for law in model.laws):
            return f"effect {model.laws[0].name!r} couples nodes through its unknowns; use dense"
        return None

    def prepare(self, problem: StepProblem, u: Unknowns) -> None:
        return None

    def factor(self, problem: StepProblem, u: Unknowns, prepared: None = None) -> tuple[NetworkParts, Graph]:
        free, dtype = problem.model.free_nodes, u.x.dtype
        law = None
        if u.z:
            node, law = _law_blocks(problem, u)
        else:
            node = node_blocks(lambda x: problem.node_rows(u.x + x, ())[0], free, dtype)
        links = problem.link_vectors(u.x)
        axes = jnp.eye(3, dtype=dtype)

        def along(axis: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.jvp(lambda d: problem.link_rows(d, u.y), (links,), (jnp.broadcast_to(axis, links.shape),))[1]

        turn, gradient = jax.vmap(along, out_axes=-1)(axes)
        _, (pull, compliance) = jax.jvp(lambda y: problem.link_rows(links, y), (u.y,), (jnp.ones_like(u.y),))
        parts = NetworkParts(node, LinkParts(turn, pull, gradient, compliance), law, problem.model.line.axial.elastic)
        return parts, problem.model.geometry

    def apply(self, factor: tuple[NetworkParts, Graph], rows: Unknowns) -> Unknowns:
        return _solve(*factor, rows)

    def apply_transposed(self, factor: tuple[NetworkParts, Graph], rows: Unknowns) -> Unknowns:
        parts, graph = factor
        return _solve(parts.transposed(), graph, rows)


def _law_blocks(problem: StepProblem, u: Unknowns) -> tuple[jax.Array, LawBlocks]:
    """A, and the blocks of the one node-local law, from five directions of forward mode."""
    (z,) = u.z

    def rows(x: jax.Array, w: jax.Array) -> tuple[jax.Array, jax.Array]:
        force, (law,) = problem.node_rows(x, (w,))
        return force, law

    def along(axis: jax.Array) -> tuple[jax.Array, jax.Array]:
        direction = jnp.broadcast_to(axis[:3], u.x.shape), jnp.broadcast_to(axis[3:], z.shape)
        return jax.jvp(rows, (u.x, z), direction)[1]

    force, law = jax.vmap(along, out_axes=-1)(jnp.eye(3 + z.shape[-1], dtype=u.x.dtype))
    return force[..., :3], LawBlocks(force[..., 3:], law[..., :3], law[..., 3:])


def _solve(parts: NetworkParts, graph: Graph, rows: Unknowns) -> Unknowns:
    node, rhs = parts.node, rows.x
    if parts.law is not None:
        own = _inverse2(parts.law.own + SOFT * jnp.eye(2, dtype=rhs.dtype))
        back = multiply(parts.law.force, own)
        node = node - multiply(back, parts.law.place)
        rhs = rhs - multiply(back, _column(rows.z[0]))[..., 0]
    if parts.elastic:
        x, y = _solve_stretching(graph, node, parts.links, rhs, rows.y)
    else:
        x, y = solve_saddle(graph, node, parts.links, rhs, rows.y)
    if parts.law is None:
        return Unknowns(x, y)
    z = multiply(own, _column(rows.z[0] - multiply(parts.law.place, _column(x))[..., 0]))[..., 0]
    return Unknowns(x, y, (z,))


def _solve_stretching(
    graph: Graph, node: jax.Array, links: LinkParts, force: jax.Array, stretch: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Moves (free, 3) and tensions (n,): these eliminated first."""
    turn, pull, gradient, compliance = links
    ratio = pull / compliance[:, None]
    stiffness = turn - _column(ratio) * gradient[:, None, :]
    x = _solve_nodes(graph, node, stiffness, force + graph.gather(ratio * stretch[:, None]))
    return x, (stretch - jnp.sum(gradient * graph.differences(x, None), axis=-1)) / compliance


def _solve_nodes(graph: Graph, node: jax.Array, stiffness: jax.Array, rhs: jax.Array) -> jax.Array:
    """Solve `node x + D'(S D x) = rhs` for the free nodes (free, 3)."""
    diagonal = node + graph.from_first(stiffness) + graph.from_last(stiffness)
    rows = line_rows(graph)
    found = _eliminate_lines(rows, diagonal, stiffness, rhs)
    points = slice(graph.inner, graph.free)
    if not len(graph.free_points):
        return found[..., 0].reshape(-1, 3)[rows.position]
    at_points = _solve_points(graph, rows, found, diagonal[points], stiffness, rhs[points])
    if not rows.nodes.size:
        return at_points
    padded = jnp.concatenate([at_points, jnp.zeros_like(at_points[:1])])  # held points do not move
    ends = jnp.concatenate([padded[rows.start], padded[rows.end]], axis=-1)
    moved = found[..., 0] + multiply(found[..., 1:], ends[:, None, :, None])[..., 0]
    return jnp.concatenate([moved.reshape(-1, 3)[rows.position], at_points])


def _eliminate_lines(rows: LineRows, diagonal: jax.Array, stiffness: jax.Array, rhs: jax.Array) -> jax.Array:
    """Moves of the inner nodes (lines, m, 3, 7): under their loads, and for unit moves of the start and the end."""
    if not rows.nodes.size:
        return jnp.zeros((0, 0, 3, 7), rhs.dtype)
    real = rows.real[..., None, None]
    inner = jnp.where(real, diagonal[rows.nodes], jnp.eye(3, dtype=rhs.dtype))  # padding solves 1 x = 0
    lower = jnp.where(real, -stiffness[rows.link_before], 0.0)
    upper = jnp.where(real, -stiffness[rows.link_before + 1], 0.0)
    load = jnp.where(rows.real[..., None], rhs[rows.nodes], 0.0)[..., None]
    from_start = jnp.where(rows.first[..., None, None], -lower, 0.0)
    from_end = jnp.where(rows.last[..., None, None], -upper, 0.0)
    # the end's coupling leaves the matrix: the padding that may follow is solved as zero
    upper = jnp.where(rows.last[..., None, None], 0.0, upper)
    return solve_tridiagonal(lower, inner, upper, jnp.concatenate([load, from_start, from_end], axis=-1))


def _solve_points(
    graph: Graph, rows: LineRows, found: jax.Array, diagonal: jax.Array, stiffness: jax.Array, rhs: jax.Array
) -> jax.Array:
    """Moves of the free points (points, 3), the lines between them being eliminated."""
    table = point_matrix(graph)
    direct = -stiffness[table.direct]
    values = [diagonal, direct, direct]
    load = rhs
    if rows.nodes.size:
        first, last = stiffness[rows.first_link], stiffness[rows.last_link]
        near, far = found[:, 0], found[np.arange(len(rows.last_row)), rows.last_row]
        pushed, pulled = multiply(first, near), multiply(last, far)  # loads and couplings on start and end
        values += [-pushed[..., 1:4], -pushed[..., 4:], -pulled[..., 1:4], -pulled[..., 4:]]
        at_start, at_end = table.start_lines, table.end_lines
        load = load.at[rows.start[at_start]].add(pushed[at_start, :, 0])
        load = load.at[rows.end[at_end]].add(pulled[at_end, :, 0])
    return solve_points(table, values, load)
