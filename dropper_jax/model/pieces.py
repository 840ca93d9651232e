"""Forces made of elements that act on a few nodes each, so that solvers know which nodes they couple."""

from __future__ import annotations

import jax
import numpy as np

from dropper_jax.base.scatter import scatter_add_many
from dropper_jax.model.graph import Graph
from dropper_jax.model.kinematics import Kinematics
from dropper_jax.model.slots import ElementForce


def at_pieces(k: Kinematics, nodes: np.ndarray) -> tuple[jax.Array, jax.Array]:
    """Positions [m] and velocities [m/s] (pieces, m, 3) of the nodes (pieces, m) of elements in a system of lines."""
    graph: Graph = k.model.geometry
    return graph.everywhere(k.r, k.ends.positions)[nodes], graph.everywhere(k.v, k.ends.velocities)[nodes]


def sum_of_pieces(effect: ElementForce, k: Kinematics) -> jax.Array:
    """Nodal force (free nodes, 3) [N] of all elements; forces on fixed points are dropped."""
    nodes = effect.piece_nodes(k.model)
    force = effect.piece_force(k, *at_pieces(k, nodes))
    free = nodes.ravel() < k.free
    return scatter_add_many(nodes.ravel()[free], force.reshape(-1, 3)[np.flatnonzero(free)], k.free)
