"""The unknowns of an equilibrium of lines: displacements of the nodes, and with rigid bodies those of `body_moves`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.model import Model, State, state
from dropper_jax.statics.body_moves import BodyMoves
from dropper_jax.statics.rest_problem import balanced, unbalanced_at
from dropper_jax.statics.tangent import Tangent


@dataclass(frozen=True)
class NodeMoves:
    """Displacements x (free, 3) [m] of the nodes of elastic lines, and forces [N] along them."""

    model: Model

    @property
    def tangent(self) -> Tangent:
        return Tangent.of(self.model)

    @property
    def retained_nodes(self) -> np.ndarray:
        return np.arange(self.model.free_nodes)

    @property
    def size(self) -> int:
        return 3 * self.model.free_nodes

    @property
    def zero_displacement(self) -> Array:
        """x at which no node is displaced."""
        return jnp.zeros((self.model.free_nodes, 3), self.model.dtype)

    def rows(self, s: State, loads: Array, x: Array) -> Array:
        """Unbalanced forces [N], minus F, at the displacement x from s."""
        return unbalanced_at(self.model, s, loads, x)[0]

    def move_pose(self, s: State, loads: Array, x: Array) -> State:
        """The configuration at the displacement x from s."""
        return balanced(self.model, state(self.model, s.r + x, t=s.t), loads)


Moves = NodeMoves | BodyMoves


def moves_of(model: Model) -> Moves:
    """The unknowns of the equilibrium of the model."""
    if model.constraints:
        return BodyMoves(model)
    return NodeMoves(model)


def stiffness_matrix(moves: Moves, s: State, loads: Array) -> Array:
    """K at a configuration in the form of its unknowns: blocks, or one matrix."""
    _, linear = jax.linearize(partial(moves.rows, s, loads), moves.zero_displacement)
    return moves.tangent.matrix(linear, moves.zero_displacement)
