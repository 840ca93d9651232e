"""Rigid bodies in the network matrix: first lines with fixed ends on bodies, then all bodies at once.

    seats:  A x_a + D'f + l = r_a,    x_a - W x_b = r_l          (f: of the links, l: multipliers of the seats)
    bodies: A x_b + B m - W'l = r_b,    C x_b = r_m              (m: multipliers of the edges and of pins)

The response of lines to a motion of the seats (attached nodes) is the force `K x_a`: one solve per seat and axis. The
remaining dense matrix has 18 unknowns per body (21 if one is pinned), `A + W' K W` bordered by the constraints. If
element forces couple lines with bodies (contact), the corners are treated like the seats.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import lu_factor, lu_solve

from dropper_jax.base.indexed_sums import scatter_add, scatter_add_many
from dropper_jax.model import Graph, HolonomicConstraint
from dropper_jax.residual import StepProblem, Unknowns
from dropper_jax.solvers.coupling import Coupling
from dropper_jax.solvers.elimination import apply, optimization_barrier
from dropper_jax.solvers.links import LinkParts
from dropper_jax.solvers.saddle import Saddle, factor_lines
from dropper_jax.solvers.stretching import Stretching

#: Unknowns of a body: positions of its corners, multipliers of its edges, and of its pin.
BODY_COORDINATES = 12
EDGES = 6
PIN = 3


@dataclass(frozen=True)
class BodyNodeMap:
    """Groups of free nodes: corners (bodies, 4), seats (seats,), the rest (retained,), and the graph of the rest.

    Attributes:
        edge: nodes whose motion acts on lines: seats first, then corners that elements couple with lines.
        pinned: indices of the pinned bodies.
    """

    graph: Graph
    rest: Graph
    corners: np.ndarray
    seats: np.ndarray
    retained_nodes: np.ndarray
    edge: np.ndarray
    pinned: np.ndarray

    @classmethod
    def of(cls, problem: StepProblem, constraint: HolonomicConstraint, between: Coupling | None) -> BodyNodeMap:
        model = problem.model
        graph = model.geometry
        corners = constraint.body_nodes(model)
        seats = constraint.seats(model)
        away = np.concatenate([corners.ravel(), seats])
        rest = _without_nodes(graph, tuple(away.tolist()))
        touched = between is not None and np.isin(corners, [pair[0] for pair in between.pairs]).any()
        edge = seats
        if touched:
            edge = np.concatenate([seats, corners.ravel()])
        retained = np.setdiff1d(np.arange(graph.free), away)
        pinned = np.array(constraint.pinned, int)
        return cls(graph, rest, corners, seats, retained, edge, pinned)

    @property
    def size(self) -> int:
        """Number of unknowns of one body."""
        if self.pinned.size:
            return BODY_COORDINATES + EDGES + PIN
        return BODY_COORDINATES + EDGES

    def sums(self, along: Array) -> Array:
        """Sum of link forces (n, 3) on the free nodes, with the sign of the rows."""
        return self.graph.from_last(along) - self.graph.from_first(along)

    def pad_seats(self, values: Array) -> Array:
        """Values (seats, ...) of the seats, and zeros of the corners on the edge."""
        more = len(self.edge) - len(self.seats)
        if more:
            return jnp.pad(values, ((0, more),) + ((0, 0),) * (values.ndim - 1))
        return values

    def split(self, between: Coupling | None) -> tuple[Coupling | None, Coupling | None]:
        """Blocks that couple retained nodes, by their indices among these, and blocks that couple others."""
        if between is None:
            return None, None
        pairs = np.array(between.pairs, int).reshape(-1, 2)
        inside = np.all(np.isin(pairs, self.retained_nodes), axis=1)
        own = np.searchsorted(self.retained_nodes, pairs[inside])
        return _blocks_at(own, between, inside), _blocks_at(pairs[~inside], between, ~inside)


def _blocks_at(pairs: np.ndarray, coupling: Coupling, chosen: np.ndarray) -> Coupling | None:
    """The chosen blocks of a coupling, at these (row, column); None if there are none."""
    if not len(pairs):
        return None
    return Coupling(tuple((row, column) for row, column in pairs.tolist()), coupling.blocks[np.flatnonzero(chosen)])


@lru_cache(maxsize=64)
def _without_nodes(graph: Graph, away: tuple[int, ...]) -> Graph:
    """The graph in which the points at these free nodes are fixed."""
    held = tuple(fixed or int(node) in away for fixed, node in zip(graph.held, graph.point_node, strict=True))
    return replace(graph, held=held)


@dataclass(frozen=True)
class Lines:
    """The lines of a scene with bodies with factored retained nodes: their response to displacements of the edge.

    Attributes:
        block: blocks (edge, 3, 3) of the edge's rows by its own displacements, without links and elements.
        others: blocks of elements that include the edge, or None.
    """

    nodes: BodyNodeMap
    links: LinkParts
    solver: Stretching | Saddle
    block: Array
    others: Coupling | None

    def transpose(self) -> Lines:
        others = self.others
        if others is not None:
            others = others.transpose()
        solver = self.solver.transpose()
        return replace(self, links=self.links.transpose(), solver=solver, block=self.block.mT, others=others)

    def response(
        self, edge: Array, force: Array | None = None, stretch: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Other displacements (free, 3), tensions (n,) and rows of the edge (edge, 3) for displacements of the edge
        (edge, 3)."""
        nodes = self.nodes
        links = self.links
        graph = self.nodes.graph
        moved = scatter_add(nodes.edge, edge, graph.free)
        d = graph.differences(moved, None)
        rows = -nodes.sums(apply(links.turn, d)) - self._by_pieces(moved)
        own = -jnp.sum(links.gradient * d, axis=-1)
        if force is not None:
            rows = force + rows
        if stretch is not None:
            own = stretch + own
        x, y = self.solver.solve(rows[nodes.retained_nodes], own)
        x = scatter_add(nodes.retained_nodes, x, graph.free)
        d = d + graph.differences(x, None)
        link_forces = nodes.sums(apply(links.turn, d) + links.force * y[:, None]) + self._by_pieces(moved + x)
        return x, y, apply(self.block, edge) + link_forces[nodes.edge]

    def _by_pieces(self, moved: Array) -> Array | float:
        """Rows (free, 3) of elements that include the edge, for displacements of all free nodes (free, 3)."""
        if self.others is None:
            return 0.0
        row, column = np.array(self.others.pairs, int).T
        return scatter_add_many(row, apply(self.others.blocks, moved[column]), len(moved))


@dataclass(frozen=True)
class BodyFactor:
    """The factored matrix of lines and bodies; `shares` are the weights of the edge in all corners."""

    lines: Lines
    shares: Array
    bodies: tuple[Array, Array]
    turned: bool = False

    def transpose(self) -> BodyFactor:
        return replace(self, lines=self.lines.transpose(), turned=not self.turned)

    def solve(self, force: Array, stretch: Array, gaps: Array) -> tuple[Array, Array, Array]:
        """Displacements (free, 3), tensions (n,) and multipliers (rows,) for r_x, r_y and the rows of the gaps."""
        lines = self.lines
        nodes = lines.nodes
        bodies = len(nodes.corners)
        seats = len(nodes.seats)
        edges, off, pins = split_gaps(gaps, nodes)
        off = nodes.pad_seats(off)
        link_force = nodes.pad_seats(force[nodes.seats])
        right = force[nodes.corners].reshape(bodies, 4, 3)
        if nodes.edge.size:
            from_lines = link_force - lines.response(off, force, stretch)[2]
            right = right + (self.shares.T @ from_lines).reshape(bodies, 4, 3)
        rows = jnp.concatenate([right.reshape(bodies, BODY_COORDINATES), edges, *pins], axis=1)
        found = lu_solve(self.bodies, rows.ravel(), trans=int(self.turned)).reshape(bodies, -1)
        corner = found[:, :BODY_COORDINATES].reshape(-1, 3)
        moved = off
        if nodes.edge.size:
            moved = off + self.shares @ corner
        x, y, link_forces = lines.response(moved, force, stretch)
        x = x + scatter_add(nodes.seats, moved[:seats], nodes.graph.free)
        x = x + scatter_add(nodes.corners.ravel(), corner, nodes.graph.free)
        _, edges, pins = jnp.split(found, [BODY_COORDINATES, BODY_COORDINATES + EDGES], axis=1)
        multipliers = edges, (link_force - link_forces)[:seats], pins[nodes.pinned]
        return x, y, jnp.concatenate([part.ravel() for part in multipliers])


def split_gaps(gaps: Array, nodes: BodyNodeMap) -> tuple[Array, Array, list[Array]]:
    """Gaps (rows,) of edges (bodies, 6), of seats (seats, 3), and, if one is pinned, of pins (bodies, 3)."""
    bodies = len(nodes.corners)
    seats = len(nodes.seats)
    edges, off, pins = jnp.split(gaps, [EDGES * bodies, EDGES * bodies + 3 * seats])
    own_pins = []
    if nodes.pinned.size:
        own_pins.append(scatter_add(nodes.pinned, pins.reshape(-1, 3), bodies))
    return edges.reshape(bodies, EDGES), off.reshape(seats, 3), own_pins


def factor_bodies(
    problem: StepProblem, u: Unknowns, node: Array, links: LinkParts, between: Coupling | None = None
) -> BodyFactor:
    """From A = `node` (free, 3, 3) of line nodes and seats, the parts of links, and the blocks of elements."""
    (constraint,) = problem.model.constraints
    nodes = BodyNodeMap.of(problem, constraint, between)
    within, others = nodes.split(between)
    solver = factor_lines(problem.model, nodes.rest, node[nodes.retained_nodes], links, within)
    lines = Lines(nodes, links, solver, nodes.pad_seats(node[nodes.seats]), others)
    if nodes.seats.size:
        shares = constraint.seat_shares()
    else:
        shares = jnp.zeros((0, nodes.corners.size), node.dtype)
    if len(nodes.edge) > len(nodes.seats):
        shares = jnp.concatenate([shares, jnp.eye(nodes.corners.size, dtype=node.dtype)])
    matrix = body_blocks(problem, u, nodes)
    count = len(nodes.corners)
    size = nodes.size
    whole = (matrix[:, :, None, :] * jnp.eye(count, dtype=node.dtype)[:, None, :, None]).reshape((count * size,) * 2)
    if edge := len(nodes.edge):
        unit = jnp.eye(3 * edge, dtype=node.dtype).reshape(-1, edge, 3)
        stiffness = jax.vmap(lambda x: lines.response(x)[2].ravel(), out_axes=1)(unit)
        mixed = jnp.einsum("ai,ajbk,bl->ijlk", shares, stiffness.reshape(edge, 3, edge, 3), shares)
        own = mixed.reshape(count, BODY_COORDINATES, count, BODY_COORDINATES)
        whole = whole + jnp.pad(own, ((0, 0), (0, size - BODY_COORDINATES)) * 2).reshape(whole.shape)
    return BodyFactor(lines, shares, lu_factor(whole))


def body_blocks(problem: StepProblem, u: Unknowns, nodes: BodyNodeMap) -> Array:
    """Rows of each body by its own unknowns (bodies, 18, 18), without seats, from 18 directions of forward mode.

    The size is 21 if one is pinned; the additional multipliers of other bodies are zero.
    """
    model = problem.model
    bodies = len(nodes.corners)
    only = problem.acting(tuple(e for e in model.effects if e.bodily))
    zero = jnp.zeros_like(u.z[-1])

    def rows(x: Array, z: Array) -> Array:
        force, (gaps,) = only.node_rows(x, (z,))
        edges, _, pins = split_gaps(gaps, nodes)
        return jnp.concatenate([force[nodes.corners].reshape(bodies, BODY_COORDINATES), edges, *pins], axis=1)

    def along(unit: Array) -> Array:
        corner, edge, pin = jnp.split(unit, [BODY_COORDINATES, BODY_COORDINATES + EDGES])
        x = scatter_add(nodes.corners.ravel(), jnp.tile(corner.reshape(4, 3), (bodies, 1)), model.free_nodes)
        edge = jnp.tile(edge, bodies)
        pin = jnp.tile(pin, len(nodes.pinned))
        between = jnp.zeros(len(zero) - len(edge) - len(pin), zero.dtype)
        return jax.jvp(rows, (u.x, u.z[-1]), (x, jnp.concatenate([edge, between, pin])))[1]

    found = optimization_barrier(jax.vmap(along, out_axes=-1)(jnp.eye(nodes.size, dtype=u.x.dtype)))
    if nodes.pinned.size:
        loose = np.zeros((bodies, nodes.size))
        loose[np.setdiff1d(np.arange(bodies), nodes.pinned), BODY_COORDINATES + EDGES :] = 1.0
        found = found + loose[:, :, None] * np.eye(nodes.size)
    return found
