"""Statics of lines and rigid bodies in coordinates that keep bodies rigid: displacements of line nodes, six per body.

A pinned body has only its three rotations, about its pin instead of the centre c of its corners.

    corners: x = c + d + R(w) (x_0 - c),    R v = v + 2 (p x v + p x (p x v))/(1 + p.p),  p = w/2
    (K + kappa) dq = Q(q),    Q = (dx/dq)' F

with the attached nodes included. The descent is that of `descent`. Dense: for hundreds of nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.indexed_sums import scatter_add
from dropper_jax.base.numerics import cross, dot
from dropper_jax.model import HolonomicConstraint, Model, State, state
from dropper_jax.statics.rest_problem import balanced, unbalanced
from dropper_jax.statics.tangent import DenseTangent


@dataclass(frozen=True)
class BodyMoves:
    """Coordinates x = q times `lever_arms` [m], and forces [N] along them.

    q (size,) are the displacements of nodes that are not on bodies (`retained_nodes`), then displacements and rotations
    of bodies. Pinned bodies (bodies,) have no displacements.
    """

    model: Model

    @property
    def constraint(self) -> HolonomicConstraint:
        return self.model.constraints[0]

    @cached_property
    def corners(self) -> np.ndarray:
        return self.constraint.body_nodes(self.model)

    @cached_property
    def retained_nodes(self) -> np.ndarray:
        on_bodies = [*self.corners.ravel(), *self.constraint.seats(self.model)]
        return np.setdiff1d(np.arange(self.model.free_nodes), on_bodies)

    @cached_property
    def pinned(self) -> np.ndarray:
        return np.isin(np.arange(len(self.corners)), self.constraint.pinned)

    @cached_property
    def used_coordinates(self) -> np.ndarray:
        """Which of the six coordinates of every body are used (k,)."""
        used = np.ones((len(self.corners), 2, 3), bool)
        used[self.pinned, 0] = False  # a pinned body has no displacement
        return np.flatnonzero(used)

    @property
    def size(self) -> int:
        return 3 * len(self.retained_nodes) + len(self.used_coordinates)

    def first_coordinate(self, body: int) -> int:
        """Index of the first coordinate of a body."""
        return 3 * len(self.retained_nodes) + int(np.searchsorted(self.used_coordinates, 6 * body))

    def positions(self, r: Array, q: Array) -> Array:
        """Positions (free, 3) [m] of all free nodes, from those at q = 0."""
        free = self.model.free_nodes
        displacements, bodies = jnp.split(q, [3 * len(self.retained_nodes)])
        corners = self._move_corners(r, bodies)
        moved = scatter_add(self.corners.ravel(), corners, free)
        seats = self.constraint.seats(self.model)
        if seats.size:
            moved = moved + scatter_add(seats, self.constraint.seat_shares() @ corners, free)
        if self.retained_nodes.size:
            retained = r[self.retained_nodes] + displacements.reshape(-1, 3)
            moved = moved + scatter_add(self.retained_nodes, retained, free)
        return moved

    def _move_corners(self, r: Array, bodies: Array) -> Array:
        """Positions (4 bodies, 3) [m] of the corners, from the coordinates of bodies that are used (k,)."""
        coordinates = scatter_add(self.used_coordinates, bodies, 6 * len(self.corners))
        shift, rotation = jnp.moveaxis(coordinates.reshape(-1, 2, 3), 1, 0)
        corners = r[self.corners]
        centre = jnp.mean(corners, axis=1, keepdims=True)
        if np.any(self.pinned):
            centre = jnp.where(self.pinned[:, None, None], self.constraint.references(corners)[:, None], centre)
        arm = corners - centre
        turn = jnp.broadcast_to(0.5 * rotation[:, None], arm.shape)
        once = cross(turn, arm)
        turned = 2.0 * (once + cross(turn, once)) / (1.0 + dot(turn, turn))[..., None]
        return (centre + shift[:, None] + arm + turned).reshape(-1, 3)

    @property
    def lever_arms(self) -> Array:
        """Lengths (size,) [m] that convert coordinates to displacements: 1, and the sizes of bodies for rotations."""
        # corners are the last points of the model, four of each body
        corners = jnp.stack([p.position for p in self.model.points])[-self.corners.size :].reshape(-1, 4, 3)
        spread = corners - jnp.mean(corners, axis=1, keepdims=True)
        size = jnp.sqrt(jnp.max(dot(spread, spread), axis=1))
        turns = jnp.repeat(jnp.stack([jnp.ones_like(size), size], axis=1).ravel(), 3)
        return jnp.concatenate([jnp.ones(3 * len(self.retained_nodes), size.dtype), turns[self.used_coordinates]])

    @property
    def tangent(self) -> DenseTangent:
        return DenseTangent()

    @property
    def zero_displacement(self) -> Array:
        """x at which no node is displaced."""
        return jnp.zeros(self.size, self.model.dtype)

    def rows(self, s: State, loads: Array, x: Array) -> Array:
        """Unbalanced generalised forces, minus Q (size,) [N]."""
        lever_arms = self.lever_arms
        r, back = jax.vjp(partial(self.positions, s.r), x / lever_arms)
        rows, _ = unbalanced(self.model, state(self.model, r, t=s.t), loads)
        return back(rows)[0] / lever_arms

    def move_pose(self, s: State, loads: Array, x: Array) -> State:
        """The configuration at the coordinates x from s."""
        return balanced(self.model, state(self.model, self.positions(s.r, x / self.lever_arms), t=s.t), loads)
