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
from dropper_jax.solvers.body_nodes import BODY_COORDINATES, EDGES, BodyNodes, split_gaps
from dropper_jax.solvers.coupling import Coupling
from dropper_jax.solvers.elimination import apply, optimization_barrier
from dropper_jax.solvers.links import LinkParts
from dropper_jax.solvers.saddle import Saddle, factor_lines
from dropper_jax.solvers.stretching import Stretching


@dataclass(frozen=True)
class FactoredLines:
    """The lines of a scene with bodies, factored: their response to displacements of the interface.

    Attributes:
        node_blocks: rows of the interface by its own displacements (interface, 3, 3), without links and elements.
        element_blocks: blocks of elements that include the interface, or None.
    """

    nodes: BodyNodes
    links: LinkParts
    solver: Stretching | Saddle
    node_blocks: Array
    element_blocks: Coupling | None

    def transpose(self) -> FactoredLines:
        element_blocks = self.element_blocks
        if element_blocks is not None:
            element_blocks = element_blocks.transpose()
        links = self.links.transpose()
        solver = self.solver.transpose()
        return FactoredLines(self.nodes, links, solver, self.node_blocks.mT, element_blocks)

    def response(
        self, interface: Array, force: Array | None = None, stretch: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Displacements of the line nodes (free, 3), tensions (n,), and rows of the interface (interface, 3).

        Args:
            interface: displacements of the interface (interface, 3).
            force: right side of the nodes (free, 3); zero if None.
            stretch: right side of the links (n,); zero if None.
        """
        nodes = self.nodes
        links = self.links
        graph = self.nodes.graph
        moved = scatter_add(nodes.interface, interface, graph.free)
        d = graph.differences(moved, None)
        rows = -nodes.sum_link_forces(apply(links.turn, d)) - self._element_rows(moved)
        own = -jnp.sum(links.gradient * d, axis=-1)
        if force is not None:
            rows = force + rows
        if stretch is not None:
            own = stretch + own
        x, y = self.solver.solve(rows[nodes.line_nodes], own)
        x = scatter_add(nodes.line_nodes, x, graph.free)
        d = d + graph.differences(x, None)
        link_rows = nodes.sum_link_forces(apply(links.turn, d) + links.force * y[:, None])
        line_rows = link_rows + self._element_rows(moved + x)
        return x, y, apply(self.node_blocks, interface) + line_rows[nodes.interface]

    def interface_stiffness(self) -> Array:
        """Rows of the interface by its own displacements (interface, 3, interface, 3): K, one solve per column."""
        count = len(self.nodes.interface)
        unit = jnp.eye(3 * count, dtype=self.node_blocks.dtype).reshape(-1, count, 3)
        columns = jax.vmap(lambda x: self.response(x)[2].ravel(), out_axes=1)(unit)
        return columns.reshape(count, 3, count, 3)

    def _element_rows(self, moved: Array) -> Array | float:
        """Rows (free, 3) of elements that include the interface, for displacements of all free nodes (free, 3)."""
        if self.element_blocks is None:
            return 0.0
        row, column = np.array(self.element_blocks.pairs, int).T
        return scatter_add_many(row, apply(self.element_blocks.blocks, moved[column]), len(moved))


@dataclass(frozen=True)
class BodyFactor:
    """The factored matrix of lines and bodies.

    Attributes:
        weights: displacements of the interface by those of all corners (interface, corners): W for the seats.
        bodies: LU factors of the dense matrix of all bodies.
    """

    lines: FactoredLines
    weights: Array
    bodies: tuple[Array, Array]
    is_transposed: bool = False

    def transpose(self) -> BodyFactor:
        return replace(self, lines=self.lines.transpose(), is_transposed=not self.is_transposed)

    def solve(self, force: Array, stretch: Array, gaps: Array) -> tuple[Array, Array, Array]:
        """Displacements (free, 3), tensions (n,) and multipliers (rows,) for r_x, r_y and the rows of the gaps."""
        lines = self.lines
        nodes = lines.nodes
        bodies = len(nodes.corners)
        seats = len(nodes.seats)
        edge_gaps, seat_gaps, pin_gaps = split_gaps(gaps, nodes)
        interface = nodes.pad_to_interface(seat_gaps)
        seat_force = nodes.pad_to_interface(force[nodes.seats])
        corner_force = force[nodes.corners].reshape(bodies, 4, 3)
        if nodes.interface.size:
            from_lines = seat_force - lines.response(interface, force, stretch)[2]
            corner_force = corner_force + (self.weights.T @ from_lines).reshape(bodies, 4, 3)
        rows = jnp.concatenate([corner_force.reshape(bodies, BODY_COORDINATES), edge_gaps, *pin_gaps], axis=1)
        solution = lu_solve(self.bodies, rows.ravel(), trans=int(self.is_transposed)).reshape(bodies, -1)
        corners, edges, pins = jnp.split(solution, [BODY_COORDINATES, BODY_COORDINATES + EDGES], axis=1)
        corners = corners.reshape(-1, 3)
        if nodes.interface.size:
            interface = interface + self.weights @ corners
        x, y, line_rows = lines.response(interface, force, stretch)
        x = x + scatter_add(nodes.seats, interface[:seats], nodes.graph.free)
        x = x + scatter_add(nodes.corners.ravel(), corners, nodes.graph.free)
        multipliers = edges, (seat_force - line_rows)[:seats], pins[nodes.pinned]
        return x, y, jnp.concatenate([part.ravel() for part in multipliers])


def factor_bodies(
    problem: StepProblem, u: Unknowns, node: Array, links: LinkParts, between: Coupling | None = None
) -> BodyFactor:
    """From A = `node` (free, 3, 3) of line nodes and seats, the parts of links, and the blocks of elements."""
    (constraint,) = problem.model.constraints
    nodes = BodyNodes.of(problem, constraint, between)
    within, element_blocks = nodes.split_coupling(between)
    solver = factor_lines(problem.model, nodes.line_graph, node[nodes.line_nodes], links, within)
    lines = FactoredLines(nodes, links, solver, nodes.pad_to_interface(node[nodes.seats]), element_blocks)
    weights = _corner_weights(constraint, nodes, node.dtype)
    matrix = _on_diagonal(body_blocks(problem, u, nodes))
    if nodes.interface.size:
        bodies = len(nodes.corners)
        stiffness = jnp.einsum("ai,ajbk,bl->ijlk", weights, lines.interface_stiffness(), weights)
        by_body = stiffness.reshape(bodies, BODY_COORDINATES, bodies, BODY_COORDINATES)
        multipliers = nodes.size - BODY_COORDINATES  # on which lines do not act
        matrix = matrix + jnp.pad(by_body, ((0, 0), (0, multipliers)) * 2).reshape(matrix.shape)
    return BodyFactor(lines, weights, lu_factor(matrix))


def _corner_weights(constraint: HolonomicConstraint, nodes: BodyNodes, dtype: jnp.dtype) -> Array:
    """Displacements of the interface by those of all corners (interface, corners): seats first, then corners."""
    weights = jnp.zeros((0, nodes.corners.size), dtype)
    if nodes.seats.size:
        weights = constraint.seat_shares()
    if len(nodes.interface) > len(nodes.seats):
        weights = jnp.concatenate([weights, jnp.eye(nodes.corners.size, dtype=dtype)])
    return weights


def _on_diagonal(blocks: Array) -> Array:
    """The matrix (n size, n size) with these blocks (n, size, size) on its diagonal."""
    count, size, _ = blocks.shape
    whole = blocks[:, :, None, :] * jnp.eye(count, dtype=blocks.dtype)[:, None, :, None]
    return whole.reshape((count * size,) * 2)


def body_blocks(problem: StepProblem, u: Unknowns, nodes: BodyNodes) -> Array:
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

    blocks = optimization_barrier(jax.vmap(along, out_axes=-1)(jnp.eye(nodes.size, dtype=u.x.dtype)))
    if nodes.pinned.size:
        unpinned = np.zeros((bodies, nodes.size))
        unpinned[np.setdiff1d(np.arange(bodies), nodes.pinned), BODY_COORDINATES + EDGES :] = 1.0
        blocks = blocks + unpinned[:, :, None] * np.eye(nodes.size)
    return blocks
