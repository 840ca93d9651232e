"""Statics of lines and rigid bodies in coordinates that keep bodies rigid: displacements of line nodes, six per body.

A pinned body has only its three rotations, about its pin instead of the centre c of its corners.

    corners: x = c + d + R(w) (x_0 - c),    R v = v + 2 (p x v + p x (p x v))/(1 + p.p),  p = w/2
    (K + kappa) dq = Q(q),    Q = (dx/dq)' F

with the attached nodes included. The descent is that of `system`. Dense: for hundreds of nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.indexed_sums import scatter_add
from dropper_jax.base.numerics import cross, dot
from dropper_jax.model import HolonomicConstraint, Model, State, state
from dropper_jax.statics.rest_problem import SMALLEST, balanced, soft_scale, unbalanced
from dropper_jax.statics.tangent import DenseTangent, NodeMoves


@dataclass(frozen=True)
class Coordinates:
    """Generalised coordinates q (3 kept + 6 bodies,) of a configuration: displacements of nodes, then displacements and
    rotations of bodies.

    Pinned bodies (bodies,) have no displacements.
    """

    retained_nodes: np.ndarray
    corners: np.ndarray
    seats: np.ndarray
    free: int
    pinned: np.ndarray

    @classmethod
    def of(cls, model: Model) -> Coordinates:
        (constraint,) = model.constraints
        corners = constraint.body_nodes(model)
        seats = constraint.seats(model)
        away = np.concatenate([corners.ravel(), seats])
        pinned = np.isin(np.arange(len(corners)), np.array(constraint.pinned, int))
        return cls(np.setdiff1d(np.arange(model.free_nodes), away), corners, seats, model.free_nodes, pinned)

    @property
    def size(self) -> int:
        return 3 * len(self.retained_nodes) + len(self.moving)

    @property
    def moving(self) -> np.ndarray:
        """Which of the six coordinates of every body are used (k,)."""
        given = np.ones((len(self.corners), 2, 3), bool)
        given[self.pinned, 0] = False
        return np.flatnonzero(given)

    def first(self, body: int) -> int:
        """Index of the first coordinate of a body."""
        return 3 * len(self.retained_nodes) + int(np.searchsorted(self.moving, 6 * body))

    def split(self, q: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Displacements of nodes (kept, 3) and bodies (bodies, 3) [m], and half rotations of bodies (bodies, 3)
        [rad]."""
        nodes = q[: 3 * len(self.retained_nodes)].reshape(-1, 3)
        bodies = scatter_add(self.moving, q[3 * len(self.retained_nodes) :], 6 * len(self.corners)).reshape(-1, 2, 3)
        return nodes, bodies[:, 0], 0.5 * bodies[:, 1]

    def positions_of(self, constraint: HolonomicConstraint, r: jax.Array, q: jax.Array) -> jax.Array:
        """Positions (free, 3) [m] of all free nodes, from those at q = 0."""
        nodes, shift, half = self.split(q)
        corner = r[self.corners]
        centre = jnp.mean(corner, axis=1, keepdims=True)
        if np.any(self.pinned):
            centre = jnp.where(self.pinned[:, None, None], constraint.references(corner)[:, None], centre)
        arm = corner - centre
        turn = jnp.broadcast_to(half[:, None], arm.shape)
        once = cross(turn, arm)
        corner = centre + shift[:, None] + arm + 2.0 * (once + cross(turn, once)) / (1.0 + dot(turn, turn))[..., None]
        corner = corner.reshape(-1, 3)
        moved = scatter_add(self.corners.ravel(), corner, self.free)
        if self.seats.size:
            moved = moved + scatter_add(self.seats, constraint.seat_shares() @ corner, self.free)
        if self.retained_nodes.size:
            return moved + scatter_add(self.retained_nodes, r[self.retained_nodes] + nodes, self.free)
        return moved


def generalised_forces(model: Model, s: State, loads: jax.Array, q: jax.Array) -> jax.Array:
    """Unbalanced generalised forces, minus Q (coordinates,) [N], [N m], at q from the pose s."""
    where = Coordinates.of(model)
    (constraint,) = model.constraints
    r, back = jax.vjp(lambda q: where.positions_of(constraint, s.r, q), q)
    rows, _ = unbalanced(model, state(model, r, t=s.t), loads)
    return back(rows)[0]


def arms(model: Model) -> jax.Array:
    """Lengths (coordinates,) [m] that convert coordinates to displacements: 1, and the sizes of bodies for
    rotations."""
    where = Coordinates.of(model)
    corner = jnp.stack([p.position for p in model.points])[-where.corners.size :].reshape(-1, 4, 3)
    spread = corner - jnp.mean(corner, axis=1, keepdims=True)
    size = jnp.sqrt(jnp.max(dot(spread, spread), axis=1))
    turns = jnp.stack([jnp.ones_like(size), size], axis=1)
    return jnp.concatenate(
        [jnp.ones(3 * len(where.retained_nodes), size.dtype), jnp.repeat(turns.ravel(), 3)[where.moving]]
    )


@dataclass(frozen=True)
class BodyMoves:
    """Coordinates x = q times `arms` [m] as the unknowns of an equilibrium, and forces [N] along
    them (see `NodeMoves`)."""

    model: Model

    @property
    def tangent(self) -> DenseTangent:
        return DenseTangent(jax.lax.stop_gradient(SMALLEST * soft_scale(self.model)))

    @property
    def none(self) -> jax.Array:
        """x of the reference configuration of the displacements."""
        return jnp.zeros(Coordinates.of(self.model).size, self.model.dtype)

    def rows(self, s: State, loads: jax.Array, x: jax.Array) -> jax.Array:
        size = arms(self.model)
        return generalised_forces(self.model, s, loads, x / size) / size

    def move_pose(self, s: State, loads: jax.Array, x: jax.Array) -> State:
        where = Coordinates.of(self.model)
        (constraint,) = self.model.constraints
        r = where.positions_of(constraint, s.r, x / arms(self.model))
        return balanced(self.model, state(self.model, r, t=s.t), loads)


def moves_of(model: Model) -> NodeMoves | BodyMoves:
    """The unknowns of the equilibrium of the model."""
    if model.constraints:
        return BodyMoves(model)
    return NodeMoves(model)


def stiffness_matrix(moves: NodeMoves | BodyMoves, s: State, loads: jax.Array) -> jax.Array:
    """K at a configuration in the form of its unknowns: blocks, or one matrix."""
    return moves.tangent.matrix(jax.linearize(partial(moves.rows, s, loads), moves.none)[1], moves.none)
