"""The nodes of rigid bodies in the network matrix: their corners, the seats of lines on them, and all others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.indexed_sums import scatter_add
from dropper_jax.model import Graph, HolonomicConstraint
from dropper_jax.residual import StepProblem
from dropper_jax.solvers.coupling import Coupling

#: Unknowns of a body: positions of its corners, multipliers of its edges, and of its pin.
BODY_COORDINATES = 12
EDGES = 6
PIN = 3


@dataclass(frozen=True)
class BodyNodes:
    """Groups of free nodes: corners (bodies, 4) of bodies, seats (seats,), and the line nodes, which are all others.

    Attributes:
        line_graph: the graph of the line nodes, with all points on bodies fixed.
        interface: nodes whose motion acts on lines: seats first, then corners that elements couple with lines.
        pinned: indices of the pinned bodies.
    """

    graph: Graph
    line_graph: Graph
    corners: np.ndarray
    seats: np.ndarray
    line_nodes: np.ndarray
    interface: np.ndarray
    pinned: np.ndarray

    @classmethod
    def of(cls, problem: StepProblem, constraint: HolonomicConstraint, between: Coupling | None) -> BodyNodes:
        model = problem.model
        graph = model.geometry
        corners = constraint.body_nodes(model)
        seats = constraint.seats(model)
        away = np.concatenate([corners.ravel(), seats])
        line_graph = _without_nodes(graph, tuple(away.tolist()))
        touched = between is not None and np.isin(corners, [pair[0] for pair in between.pairs]).any()
        interface = seats
        if touched:
            interface = np.concatenate([seats, corners.ravel()])
        line_nodes = np.setdiff1d(np.arange(graph.free), away)
        pinned = np.array(constraint.pinned, int)
        return cls(graph, line_graph, corners, seats, line_nodes, interface, pinned)

    @property
    def size(self) -> int:
        """Number of unknowns of one body."""
        if self.pinned.size:
            return BODY_COORDINATES + EDGES + PIN
        return BODY_COORDINATES + EDGES

    def sum_link_forces(self, along: Array) -> Array:
        """Sum of link forces (n, 3) on the free nodes, with the sign of the rows."""
        return self.graph.from_last(along) - self.graph.from_first(along)

    def pad_to_interface(self, values: Array) -> Array:
        """Values (seats, ...) of the seats, and zeros of the corners on the interface."""
        more = len(self.interface) - len(self.seats)
        if more:
            return jnp.pad(values, ((0, more),) + ((0, 0),) * (values.ndim - 1))
        return values

    def split_coupling(self, between: Coupling | None) -> tuple[Coupling | None, Coupling | None]:
        """Blocks that couple line nodes only, by their indices among these, and all other blocks."""
        if between is None:
            return None, None
        pairs = np.array(between.pairs, int).reshape(-1, 2)
        inside = np.all(np.isin(pairs, self.line_nodes), axis=1)
        own = np.searchsorted(self.line_nodes, pairs[inside])
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


def split_gaps(gaps: Array, nodes: BodyNodes) -> tuple[Array, Array, list[Array]]:
    """Gaps (rows,) of edges (bodies, 6), of seats (seats, 3), and, if one is pinned, of pins (bodies, 3)."""
    bodies = len(nodes.corners)
    seats = len(nodes.seats)
    edges, of_seats, pins = jnp.split(gaps, [EDGES * bodies, EDGES * bodies + 3 * seats])
    pins_by_body = []
    if nodes.pinned.size:
        pins_by_body.append(scatter_add(nodes.pinned, pins.reshape(-1, 3), bodies))
    return edges.reshape(bodies, EDGES), of_seats.reshape(seats, 3), pins_by_body
