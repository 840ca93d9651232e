"""Rigid bodies in the network's matrix: lines with their ends on bodies held first, then all bodies at once.

    seats:  A x_a + D'f + l = r_a,    x_a - W x_b = r_l          (f: of the links, l: multipliers of the seats)
    bodies: A x_b + B m - W'l = r_b,    C x_b = r_m              (m: multipliers of the edges)

Lines answer a motion of the seats with the forces `K x_a`: one solve per seat and axis. What is left is a dense matrix
of 18 unknowns per body, `A + W' K W` bordered by the constraints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import lu_factor, lu_solve

from dropper_jax.base.place import place
from dropper_jax.model import Graph, Tie
from dropper_jax.residual import StepProblem, Unknowns
from dropper_jax.solvers.blocks import settled
from dropper_jax.solvers.saddle import LinkParts, Saddle
from dropper_jax.solvers.stretching import Stretching

#: Unknowns of a body: places of its corners, and multipliers of its edges.
PLACES, EDGES = 12, 6


@dataclass(frozen=True)
class Carried:
    """Which free nodes are whose: corners (bodies, 4), seats (seats,), the rest (kept,), and the graph of the rest."""

    graph: Graph
    rest: Graph
    corners: np.ndarray
    seats: np.ndarray
    kept: np.ndarray

    @classmethod
    def of(cls, problem: StepProblem, tie: Tie) -> Carried:
        graph, corners, seats = problem.model.geometry, tie.corners(problem.model), tie.seats(problem.model)
        away = np.concatenate([corners.ravel(), seats])
        rest = _rest(graph, tuple(away.tolist()))
        return cls(graph, rest, corners, seats, np.setdiff1d(np.arange(graph.free), away))

    def moved(self, seats: jax.Array) -> jax.Array:
        """Moves of the seats (seats, 3) among those of all free nodes."""
        return place(self.seats, seats, self.graph.free)

    def sums(self, along: jax.Array) -> jax.Array:
        """Sum on the free nodes of what links (n, 3) carry, in the sign of the rows."""
        return self.graph.from_last(along) - self.graph.from_first(along)


@lru_cache(maxsize=64)
def _rest(graph: Graph, away: tuple[int, ...]) -> Graph:
    held = tuple(fixed or int(node) in away for fixed, node in zip(graph.held, graph.point_node, strict=True))
    return replace(graph, held=held)


@dataclass(frozen=True)
class BodyFactor:
    """The factored matrix of lines and bodies."""

    nodes: Carried
    links: LinkParts
    lines: Stretching | Saddle
    seat: jax.Array
    shares: jax.Array
    stiffness: jax.Array
    bodies: tuple[jax.Array, jax.Array]
    turned: bool = False

    def transposed(self) -> BodyFactor:
        flip = lambda a: jnp.swapaxes(a, -1, -2)  # noqa: E731
        return replace(
            self,
            links=self.links.transposed(),
            lines=self.lines.transposed(),
            seat=flip(self.seat),
            stiffness=self.stiffness.T,
            turned=not self.turned,
        )

    def solve(self, force: jax.Array, stretch: jax.Array, gaps: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Moves (free, 3), tensions (n,) and multipliers (rows,) for r_x, r_y and the gaps' rows."""
        nodes, bodies = self.nodes, len(self.nodes.corners)
        edges, off = gaps[: EDGES * bodies].reshape(bodies, EDGES), gaps[EDGES * bodies :].reshape(-1, 3)
        seat_force = force[nodes.seats]
        right = force[nodes.corners].reshape(bodies, 4, 3)
        if nodes.seats.size:
            _, _, pulled = answer(nodes, self.links, self.lines, self.seat, off, force, stretch)
            right = right + (self.shares.T @ (seat_force - pulled)).reshape(bodies, 4, 3)
        rows = jnp.concatenate([right.reshape(bodies, PLACES), edges], axis=1)
        found = lu_solve(self.bodies, rows.ravel(), trans=1 if self.turned else 0).reshape(bodies, -1)
        corner = found[:, :PLACES].reshape(-1, 3)
        seats = off + self.shares @ corner if nodes.seats.size else off
        x, y, pulled = answer(nodes, self.links, self.lines, self.seat, seats, force, stretch)
        x = x + nodes.moved(seats) + place(nodes.corners.ravel(), corner, nodes.graph.free)
        return x, y, jnp.concatenate([found[:, PLACES:].ravel(), (seat_force - pulled).ravel()])


def answer(
    nodes: Carried,
    links: LinkParts,
    lines: Stretching | Saddle,
    seat: jax.Array,
    seats: jax.Array,
    force: jax.Array | None = None,
    stretch: jax.Array | None = None,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """What lines do as their seats move (seats, 3): other moves (free, 3), tensions (n,), seats' rows (seats, 3)."""
    graph = nodes.graph
    d = graph.differences(nodes.moved(seats), None)
    rows = -nodes.sums(jnp.sum(links.turn * d[:, None, :], axis=-1))
    own = -jnp.sum(links.gradient * d, axis=-1)
    rows, own = (rows if force is None else force + rows), (own if stretch is None else stretch + own)
    x, y = lines.solve(rows[nodes.kept], own)
    x = place(nodes.kept, x, graph.free)
    d = d + graph.differences(x, None)
    along = jnp.sum(links.turn * d[:, None, :], axis=-1) + links.pull * y[:, None]
    return x, y, jnp.sum(seat * seats[:, None, :], axis=-1) + nodes.sums(along)[nodes.seats]


def factor_bodies(problem: StepProblem, u: Unknowns, node: jax.Array, links: LinkParts) -> BodyFactor:
    """From A = `node` (free, 3, 3) of the lines' nodes and seats, and the links' parts."""
    (tie,) = problem.model.ties
    nodes = Carried.of(problem, tie)
    kind = Stretching if problem.model.line.axial.elastic else Saddle
    lines = kind.of(nodes.rest, node[nodes.kept], links)
    shares = tie.seat_shares() if nodes.seats.size else jnp.zeros((0, nodes.corners.size), node.dtype)
    seat = node[nodes.seats]
    matrix, count = body_blocks(problem, u, nodes), len(nodes.corners)
    seats = 3 * nodes.seats.size
    stiffness = jnp.zeros((seats, seats), node.dtype)
    whole = (matrix[:, :, None, :] * jnp.eye(count, dtype=node.dtype)[:, None, :, None]).reshape((count * 18,) * 2)
    if seats:
        unit = jnp.eye(seats, dtype=node.dtype).reshape(seats, -1, 3)
        stiffness = jax.vmap(lambda x: answer(nodes, links, lines, seat, x)[2].ravel(), out_axes=1)(unit)
        mixed = jnp.einsum("ai,ajbk,bl->ijlk", shares, stiffness.reshape(-1, 3, seats // 3, 3), shares)
        own = mixed.reshape(count, PLACES, count, PLACES)
        whole = whole + jnp.pad(own, ((0, 0), (0, EDGES)) * 2).reshape(whole.shape)
    return BodyFactor(nodes, links, lines, seat, shares, stiffness, lu_factor(whole))


def body_blocks(problem: StepProblem, u: Unknowns, nodes: Carried) -> jax.Array:
    """Rows of each body by its own unknowns (bodies, 18, 18), seats aside, from 18 directions of forward mode."""
    model, bodies = problem.model, len(nodes.corners)
    only = problem.acting(tuple(e for e in model.effects if e.bodily))
    zero = jnp.zeros_like(u.z[-1])

    def rows(x: jax.Array, z: jax.Array) -> jax.Array:
        force, (gaps,) = only.node_rows(x, (z,))
        own = force[nodes.corners].reshape(bodies, PLACES)
        return jnp.concatenate([own, gaps[: EDGES * bodies].reshape(bodies, EDGES)], axis=1)

    def along(unit: jax.Array) -> jax.Array:
        x = place(nodes.corners.ravel(), jnp.tile(unit[:PLACES].reshape(4, 3), (bodies, 1)), model.free_nodes)
        z = zero.at[: EDGES * bodies].set(jnp.tile(unit[PLACES:], bodies))
        return jax.jvp(rows, (u.x, u.z[-1]), (x, z))[1]

    return settled(jax.vmap(along, out_axes=-1)(jnp.eye(PLACES + EDGES, dtype=u.x.dtype)))
