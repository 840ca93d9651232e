"""Rigid bodies in the network matrix: first lines with fixed ends on bodies, then all bodies at once.

    seats:  A x_a + D'f + l = r_a,    x_a - W x_b = r_l          (f: of the links, l: multipliers of the seats)
    bodies: A x_b + B m - W'l = r_b,    C x_b = r_m              (m: multipliers of the edges and of pins)

The response of lines to a motion of the seats (attached nodes) is the force `K x_a`: one solve per seat and axis. The
remaining dense matrix has 18 unknowns per body (21 if one is pinned), `A + W' K W` bordered by the constraints. If
element forces couple lines with bodies (contact), the corners are treated like the seats.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import lu_factor, lu_solve

from dropper_jax.base.indexed_sums import scatter_add, scatter_add_many
from dropper_jax.model import HolonomicConstraint
from dropper_jax.residual import StepProblem, Unknowns
from dropper_jax.solvers.body_nodes import BODY_COORDINATES, EDGES, BodyNodeMap, split_gaps
from dropper_jax.solvers.coupling import Coupling
from dropper_jax.solvers.elimination import apply, optimization_barrier
from dropper_jax.solvers.links import LinkParts
from dropper_jax.solvers.saddle import Saddle, factor_lines
from dropper_jax.solvers.stretching import Stretching


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
        rows = -nodes.sum_link_forces(apply(links.turn, d)) - self._by_pieces(moved)
        own = -jnp.sum(links.gradient * d, axis=-1)
        if force is not None:
            rows = force + rows
        if stretch is not None:
            own = stretch + own
        x, y = self.solver.solve(rows[nodes.retained_nodes], own)
        x = scatter_add(nodes.retained_nodes, x, graph.free)
        d = d + graph.differences(x, None)
        along = apply(links.turn, d) + links.force * y[:, None]
        link_forces = nodes.sum_link_forces(along) + self._by_pieces(moved + x)
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


def factor_bodies(
    problem: StepProblem, u: Unknowns, node: Array, links: LinkParts, between: Coupling | None = None
) -> BodyFactor:
    """From A = `node` (free, 3, 3) of line nodes and seats, the parts of links, and the blocks of elements."""
    (constraint,) = problem.model.constraints
    nodes = BodyNodeMap.of(problem, constraint, between)
    within, others = nodes.split(between)
    solver = factor_lines(problem.model, nodes.rest, node[nodes.retained_nodes], links, within)
    lines = Lines(nodes, links, solver, nodes.pad_seats(node[nodes.seats]), others)
    shares = _edge_shares(constraint, nodes, node.dtype)
    matrix = _on_diagonal(body_blocks(problem, u, nodes))
    if nodes.edge.size:
        own = _stiffness_of_lines(lines, shares)
        beside = nodes.size - BODY_COORDINATES  # multipliers, on which lines do not act
        matrix = matrix + jnp.pad(own, ((0, 0), (0, beside)) * 2).reshape(matrix.shape)
    return BodyFactor(lines, shares, lu_factor(matrix))


def _edge_shares(constraint: HolonomicConstraint, nodes: BodyNodeMap, dtype: jnp.dtype) -> Array:
    """Weights (edge, corners) of the corners in the displacements of the edge."""
    shares = jnp.zeros((0, nodes.corners.size), dtype)
    if nodes.seats.size:
        shares = constraint.seat_shares()
    if len(nodes.edge) > len(nodes.seats):
        shares = jnp.concatenate([shares, jnp.eye(nodes.corners.size, dtype=dtype)])
    return shares


def _on_diagonal(blocks: Array) -> Array:
    """The matrix (n size, n size) with these blocks (n, size, size) on its diagonal."""
    count, size, _ = blocks.shape
    whole = blocks[:, :, None, :] * jnp.eye(count, dtype=blocks.dtype)[:, None, :, None]
    return whole.reshape((count * size,) * 2)


def _stiffness_of_lines(lines: Lines, shares: Array) -> Array:
    """Derivatives (bodies, 12, bodies, 12) of the forces of lines on the corners of bodies by their displacements."""
    edge = len(lines.nodes.edge)
    bodies = len(lines.nodes.corners)
    unit = jnp.eye(3 * edge, dtype=shares.dtype).reshape(-1, edge, 3)
    stiffness = jax.vmap(lambda x: lines.response(x)[2].ravel(), out_axes=1)(unit)
    of_corners = jnp.einsum("ai,ajbk,bl->ijlk", shares, stiffness.reshape(edge, 3, edge, 3), shares)
    return of_corners.reshape(bodies, BODY_COORDINATES, bodies, BODY_COORDINATES)


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
