"""Statics of lines and rigid bodies in coordinates that leave bodies rigid: moves of the lines' nodes, six per body.

A pinned body has its three turns only, about its pin in place of the middle c of its corners.

    corners: x = c + d + R(w) (x_0 - c),    R v = v + 2 (p x v + p x (p x v))/(1 + p.p),  p = w/2
    (K + kappa) dq = Q(q),    Q = (dx/dq)' F

with the seats carried along. The descent is that of `system`: K holds all forces, a share of dq is taken that does not
overshoot, kappa falls while whole steps are taken. Dense: for hundreds of nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.numerics import cross, dot
from dropper_jax.base.place import place
from dropper_jax.base.programs import kept
from dropper_jax.model import Model, State, Tie, state
from dropper_jax.residual import GRAVITY_SCALE
from dropper_jax.statics.rest_problem import unbalanced
from dropper_jax.statics.system import (
    FALL,
    HOPELESS,
    KEEP,
    OVERSHOOT,
    RISE,
    ROUNDS,
    SHARES,
    SMALLEST,
    SOFTENING,
    guess,
    with_axial,
)

#: Largest move of a node in one round [m], and part of a body's weight that residual forces are measured against.
REACH, PART = 1.0, 1e-2
#: Unbalanced force, over its scale, of an accepted pose: what rounding leaves of stiff lines and large buoyancies.
TOLERANCE = 1e-9
#: Newton's corrections for derivatives of a pose.
CORRECTIONS = 12


@dataclass(frozen=True)
class Coordinates:
    """Generalised coordinates q (3 kept + 6 bodies,) of a pose: moves of nodes, then moves and turns of bodies.

    Bodies that are pinned (bodies,) have no moves.
    """

    kept: np.ndarray
    corners: np.ndarray
    seats: np.ndarray
    free: int
    pinned: np.ndarray

    @classmethod
    def of(cls, model: Model) -> Coordinates:
        (tie,) = model.ties
        corners, seats = tie.body_nodes(model), tie.seats(model)
        away = np.concatenate([corners.ravel(), seats])
        pinned = np.isin(np.arange(len(corners)), np.array(tie.pinned, int))
        return cls(np.setdiff1d(np.arange(model.free_nodes), away), corners, seats, model.free_nodes, pinned)

    @property
    def size(self) -> int:
        return 3 * len(self.kept) + len(self.moving)

    @property
    def moving(self) -> np.ndarray:
        """Which of the six coordinates of every body are there (k,)."""
        given = np.ones((len(self.corners), 2, 3), bool)
        given[self.pinned, 0] = False
        return np.flatnonzero(given)

    def first(self, body: int) -> int:
        """Number of the first coordinate of a body."""
        return 3 * len(self.kept) + int(np.searchsorted(self.moving, 6 * body))

    def split(self, q: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Moves of nodes (kept, 3) and bodies (bodies, 3) [m], and half turns of bodies (bodies, 3) [rad]."""
        nodes = q[: 3 * len(self.kept)].reshape(-1, 3)
        bodies = place(self.moving, q[3 * len(self.kept) :], 6 * len(self.corners)).reshape(-1, 2, 3)
        return nodes, bodies[:, 0], 0.5 * bodies[:, 1]

    def place(self, tie: Tie, r: jax.Array, q: jax.Array) -> jax.Array:
        """Places (free, 3) [m] of all free nodes, from those at q = 0."""
        nodes, shift, half = self.split(q)
        corner = r[self.corners]
        centre = jnp.mean(corner, axis=1, keepdims=True)
        if np.any(self.pinned):
            centre = jnp.where(self.pinned[:, None, None], tie.references(corner)[:, None], centre)
        arm = corner - centre
        turn = jnp.broadcast_to(half[:, None], arm.shape)
        once = cross(turn, arm)
        corner = centre + shift[:, None] + arm + 2.0 * (once + cross(turn, once)) / (1.0 + dot(turn, turn))[..., None]
        corner = corner.reshape(-1, 3)
        moved = place(self.corners.ravel(), corner, self.free)
        if self.seats.size:
            moved = moved + place(self.seats, tie.seat_shares() @ corner, self.free)
        return moved + place(self.kept, r[self.kept] + nodes, self.free) if self.kept.size else moved


def generalised(model: Model, s: State, loads: jax.Array, q: jax.Array) -> jax.Array:
    """Unbalanced generalised forces, minus Q (coordinates,) [N], [N m], at q from the pose s."""
    where, (tie,) = Coordinates.of(model), model.ties
    r, back = jax.vjp(lambda q: where.place(tie, s.r, q), q)
    rows, _ = unbalanced(model, state(model, r, t=s.t), loads)
    return back(rows)[0]


def arms(model: Model) -> jax.Array:
    """Lengths (coordinates,) [m] that make moves of the coordinates: 1, and the bodies' sizes for turns."""
    where = Coordinates.of(model)
    corner = jnp.stack([p.position for p in model.points])[-where.corners.size :].reshape(-1, 4, 3)
    spread = corner - jnp.mean(corner, axis=1, keepdims=True)
    size = jnp.sqrt(jnp.max(dot(spread, spread), axis=1))
    turns = jnp.stack([jnp.ones_like(size), size], axis=1)
    return jnp.concatenate([jnp.ones(3 * len(where.kept), size.dtype), jnp.repeat(turns.ravel(), 3)[where.moving]])


def bodies_scale(model: Model) -> jax.Array:
    """What residual forces are measured against, a scalar [N]."""
    heaviest = jnp.max(model.ties[0].mass)
    return GRAVITY_SCALE * jnp.maximum(jnp.mean(model.line.mass), PART * heaviest)


@kept(brief=True)
def _round(model: Model, s: State, loads: jax.Array, kappa: jax.Array) -> tuple[State, jax.Array, jax.Array]:
    """One correction of the pose s; the next pose, its largest scaled unbalanced force, and the share taken."""
    where, (tie,) = Coordinates.of(model), model.ties
    size = arms(model)
    rows_of = lambda q: generalised(model, s, loads, q * size) * size  # noqa: E731  all in moves [m] and forces [N]
    zero = jnp.zeros(where.size, model.dtype)
    rows, matrix = rows_of(zero), jax.jacfwd(rows_of)(zero)
    dq = -jnp.linalg.solve(matrix + kappa * jnp.eye(where.size, dtype=model.dtype), rows)
    dq = dq * jnp.minimum(1.0, REACH / jnp.maximum(jnp.max(jnp.abs(dq)), 1e-300))

    def along(share: jax.Array) -> jax.Array:
        return -jnp.sum(rows_of(share * dq) * dq)

    shares = jnp.asarray(SHARES, model.dtype)
    good = jax.lax.map(along, shares) >= OVERSHOOT * jnp.sum(rows * dq)  # rows are minus the forces
    share = shares[jnp.argmax(good.at[-1].set(True))]
    r = where.place(tie, s.r, share * dq * size)
    after, tension = unbalanced(model, state(model, r, t=s.t), loads)
    s = state(model, r, tension=tension, t=s.t)
    left = generalised(model, s, loads, zero) / jnp.maximum(size, 1.0)
    return s, jnp.max(jnp.abs(left)) / bodies_scale(model), share


def descend(model: Model, s: State, loads: jax.Array) -> tuple[State, float]:
    """The stable pose that descent from `s` reaches, and its largest scaled unbalanced force."""
    scale, length = float(bodies_scale(model)), float(jnp.mean(model.line.length))
    kappa, reached, best = scale / length, 0, (s, np.inf)
    for count in range(ROUNDS):
        s, residual, share = _round(model, s, loads, jnp.asarray(kappa, model.dtype))
        residual, share = float(residual), float(share)
        kappa *= FALL if share == 1.0 else KEEP if share >= 0.25 else RISE
        kappa = max(kappa, SMALLEST * scale / length)
        if residual < best[1]:
            best = (s, residual)
        reached = reached + 1 if residual <= TOLERANCE else 0
        hopeless = count > HOPELESS and best[1] > 1e3 * TOLERANCE
        if not np.isfinite(residual) or reached > 1 or hopeless:
            break
    return best


def rest_with_bodies(model: Model, loads: jax.Array, t: float) -> tuple[State, float, str]:
    """The pose at rest of lines and bodies, its largest scaled unbalanced force, and what is wrong (or nothing)."""
    start = started(model, t)
    s, residual = descend(model, start, loads)
    if not residual <= TOLERANCE:  # by way of softer lines, as `system.find_softened`
        other = start, np.inf
        for share in SOFTENING:
            other = descend(with_axial(model, model.line.axial.softened(share)), other[0], loads)
        if other[1] < residual:
            s, residual = other
    if residual <= TOLERANCE:
        return s, residual, ""
    return s, residual, f"no equilibrium of lines and bodies found: largest scaled unbalanced force {residual:.1e}"


def started(model: Model, t: float) -> State:
    """Bodies where the scene puts them, lines straight between their points."""
    s = guess(model, t)
    places = np.array([np.asarray(p.position, float) for p in model.points])
    r = np.array(s.r)
    points = model.geometry.free_points
    r[model.geometry.point_node[points]] = places[points]
    return state(model, jnp.asarray(r), t=t)


def settled_with_bodies(model: Model, near: State, loads: jax.Array) -> State:
    """The pose next to `near`, with derivatives by the implicit function theorem (see `static_pose.settle`)."""
    where, (tie,) = Coordinates.of(model), model.ties
    size = arms(model)

    def solve(f: object, q: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, CORRECTIONS, lambda _, y: y - jnp.linalg.solve(jax.jacfwd(f)(y), f(y)), q)

    def tangent(g: object, b: jax.Array) -> jax.Array:
        return jnp.linalg.solve(jax.jacfwd(g)(jnp.zeros_like(b)), b)

    rows = lambda q: generalised(model, near, loads, q * size) * size  # noqa: E731
    q = jax.lax.custom_root(rows, jnp.zeros(where.size, model.dtype), solve, tangent) * size
    r = where.place(tie, near.r, q)
    _, tension = unbalanced(model, state(model, r, t=near.t), loads)
    return state(model, r, tension=tension, t=near.t)


def free_motions(model: Model, pose: State) -> jax.Array:
    """dx/dq (free, 3, coordinates) at a pose: the motions that leave bodies rigid."""
    where, (tie,) = Coordinates.of(model), model.ties
    zero = jnp.zeros(where.size, model.dtype)
    return jax.jacfwd(lambda q: where.place(tie, pose.r, q))(zero)
