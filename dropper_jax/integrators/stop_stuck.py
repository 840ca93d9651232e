"""Friction at the end of a step, on joints that were stuck at its middle: it stops them.

A law on the mid-step rate holds a joint by `w_mid = 0`, which turns its rate w0 into `-w0` at every step. The end
velocities of such a step are therefore changed by impulses P of the stuck joints (and pi of the tensions), within
the limit of friction over the step:

    M delta = B' P + G' pi,    B (v1 + delta) = 0 on stuck joints,    |h z + P| <= h tau    (pi = 0 for elastic links)

In the mass metric this is a projection, so it takes kinetic energy and never adds any (Moreau 1988). The energy
that it takes is work of the law. If the bound is reached, the impulse stays on it and the joint keeps moving.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.flatten_util import ravel_pytree
from jax.scipy.linalg import lu_factor, lu_solve

from dropper_jax.base.numerics import dot
from dropper_jax.model import Kinematics, Law, Model
from dropper_jax.residual import PerLaw, Unknowns

#: Number of Newton corrections: the first is exact if no impulse reaches its bound. A joint that reaches its bound in
#: the last one keeps more than its part of one step. That affects the accuracy of this event, never the energy.
CORRECTIONS = 3
#: Excess of an impulse over its bound, relative to it, up to which both differ by rounding.
BEYOND_ROUNDING = 1e-9
#: Factor of an impulse on its bound whose nearest allowed one is on the bound despite rounding.
OUTWARDS = 2.0


class _StuckJoints(NamedTuple):
    """Joints that were stuck over a step h [s].

    Attributes:
        held: which of the joints of each law are stuck (joints, 1).
        z: the laws' unknowns over the step.
    """

    model: Model
    held: PerLaw
    z: PerLaw
    h: Array


class _Bounds(NamedTuple):
    """Impulses on their bounds: of which joints of each law (joints, 1), and their directions."""

    reached: PerLaw
    directions: PerLaw


def stop_stuck_joints(model: Model, z: PerLaw, middle: Kinematics, after: Kinematics, h: Array) -> tuple[Array, Array]:
    """End velocities (nodes, 3) [m/s] with stuck joints at rest, and the work of that (<= 0) [J].

    Args:
        z: the laws' unknowns over the step.
        middle, after: the middle and the end of the step.
        h: the step [s].
    """
    held = tuple(law.holding(middle, torque, h) for law, torque in zip(model.laws, z, strict=True))
    any_held = jnp.any(jnp.stack(list(map(jnp.any, held))))
    # a copy of the end: what the branch computes must not be kept for uses outside of it
    stopped = partial(_stop_nodes, _StuckJoints(model, held, z, h), after.with_velocity(after.v))
    # most steps have no stuck joint, and then none of this is executed
    return jax.lax.cond(any_held, stopped, lambda: (after.v, jnp.zeros((), after.v.dtype)))


def _stop_nodes(stuck: _StuckJoints, after: Kinematics) -> tuple[Array, Array]:
    """The results of `stop_stuck_joints` where a joint is stuck."""
    # neither solution nor factors are differentiated: one more correction with differentiated rows has the exact
    # derivative of the solution, at the cost of a few operations
    u, factor, bounds = _solve(*jax.lax.stop_gradient((stuck, after.v, after.r, after.t)))
    rows = ravel_pytree(_rows(stuck, after, bounds, u))[0]
    flat, unravel = ravel_pytree(u)
    return _with_least_energy(stuck.model, after, unravel(flat - lu_solve(factor, rows)).x)


def stop_stuck_nodes(model: Model, z: PerLaw, middle: Kinematics, after: Kinematics, h: Array) -> tuple[Array, Array]:
    """The same for laws that hold nodes individually (`node_local`): each simply stops, as its `stop` defines."""
    v1 = after.v
    for law, held in zip(model.laws, z, strict=True):
        v1 = law.stop(middle, v1, held, h)
    return v1, model.kinetic_energy(after.with_velocity(v1)) - model.kinetic_energy(after)


@jax.jit  # traced once, not at each of the half dozen positions of a differentiated step
def _solve(stuck: _StuckJoints, v: Array, r: Array, t: Array) -> tuple[Unknowns, PerLaw, _Bounds]:
    """Unknowns, factors of their matrix, and the impulses that are on their bounds."""
    model = stuck.model
    after = model.kinematics(r, v, t)
    zero = Unknowns(jnp.zeros_like(v), jnp.zeros_like(model.line.length), tuple(map(jnp.zeros_like, stuck.z)))
    flat, unravel = ravel_pytree(zero)

    def correct(carry: tuple[Any, ...], _: None) -> tuple[tuple[Any, ...], None]:
        x, _, bounds = carry

        def rows(x: Array) -> Array:
            return ravel_pytree(_rows(stuck, after, bounds, unravel(x)))[0]

        factor = lu_factor(jax.jacfwd(rows)(x))
        x = x - lu_solve(factor, rows(x))
        return (x, factor, _next_bounds(stuck, bounds, unravel(x).z)), None

    none_reached = _Bounds(tuple(map(jnp.zeros_like, stuck.held)), zero.z)
    start = flat, lu_factor(jnp.eye(len(flat), dtype=flat.dtype)), none_reached
    x, factor, bounds = jax.lax.scan(correct, start, None, length=CORRECTIONS)[0]
    return unravel(x), factor, bounds


def _next_bounds(stuck: _StuckJoints, bounds: _Bounds, impulses: PerLaw) -> _Bounds:
    """The bounds, with those that these impulses (joints, c) of each law exceed."""
    reached = ()
    directions = ()
    of_laws = zip(stuck.model.laws, impulses, stuck.z, stuck.held, *bounds, strict=True)
    for law, p, q, is_held, was_reached, direction in of_laws:
        beyond = is_held & ~was_reached & _beyond(law, p, q, stuck.h)
        reached = (*reached, was_reached | beyond)
        directions = (*directions, jnp.where(beyond, OUTWARDS * (p / stuck.h + q), direction))
    return _Bounds(reached, directions)


def _beyond(law: Law, p: Array, q: Array, h: Array) -> Array:
    """Joints (joints, 1) whose impulse exceeds its bound; within the bound both differ by rounding of p and h q.

    A joint wrongly classified as exceeding its bound would have a row of zeros.
    """
    size = jnp.max(jnp.abs(p) + jnp.abs(h * q), axis=-1, keepdims=True)
    # the impulse nearest to p that keeps `h q + p`, friction's impulse over the full step, within its bound
    nearest = h * law.admissible(p / h + q) - h * q
    return jnp.max(jnp.abs(p - nearest), axis=-1, keepdims=True) > BEYOND_ROUNDING * size


#: Relative compliance of the impulses: there may be more stuck joints than motions that they stop (8 joints, 5 motions
#: of a plane loop of 7 links), and the distribution of the load is then arbitrary.
IMPULSE_COMPLIANCE = 1e-10


def _rows(stuck: _StuckJoints, after: Kinematics, bounds: _Bounds, u: Unknowns) -> Unknowns:
    """Rows of the system above for velocity changes, impulses of tensions and of joints.

    An impulse that exceeds its bound stays on it and keeps its direction. Otherwise all points of the bound would be
    solutions, and a row with free direction would be singular.
    """
    model, held, z, h = stuck
    line = model.line
    scale = jnp.mean(line.mass * line.length**2)
    moved = after.with_velocity(after.v + u.x)
    force = model.inertia(after, u.x) - model.tension_force(u.y, after.tangents)
    joints = ()
    for law, p, q, is_held, is_at_bound, direction in zip(model.laws, u.z, z, held, *bounds, strict=True):
        force = force - law.law_force(after, p)
        at_rest = scale * law.rates(moved) + IMPULSE_COMPLIANCE * p
        on_bound = p - h * (law.admissible(direction) - q)
        joints = (*joints, jnp.where(is_at_bound, on_bound, jnp.where(is_held, at_rest, p)))
    along = u.y
    if not line.axial.elastic:
        rate = jnp.where(_both_held(model, held)[:, None], moved.link_velocities, model.link_rates(u.x, None))
        along = jnp.mean(line.mass) * dot(after.tangents, rate)
    return Unknowns(force, along, joints)


def _both_held(model: Model, held: tuple[Array, ...]) -> Array:
    """Links (n,) whose two joints are stuck by one law: they stop completely, including their rate of length."""
    links = model.line.links
    both = jnp.zeros(links, bool)
    for one in held:
        if one.shape[0] > links:
            both = both | (one[:-1, 0] & one[1:, 0])
    return both


#: Below the normal numbers a quotient is 0/0 if the processor flushes them; nothing moves any more at that scale.
NORMAL_NUMBERS = 1e3


def _with_least_energy(model: Model, after: Kinematics, delta: Array) -> tuple[Array, Array]:
    """`v + s delta` with the s in [0, 1] of minimum kinetic energy (1 if delta is a projection), and its change."""
    weight = jnp.sum(delta * model.inertia(after, delta))
    slope = jnp.sum(delta * model.inertia(after, after.v))
    moves = weight > NORMAL_NUMBERS * jnp.finfo(weight.dtype).tiny
    share = jnp.clip(-slope / jnp.where(moves, weight, 1.0), 0.0, 1.0)
    share = jnp.where(moves, share, 0.0)
    return after.v + share * delta, share * (slope + 0.5 * share * weight)
