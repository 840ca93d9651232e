"""Velocities that are consistent with rigid links: the smallest change, in the mass metric, after which no link
stretches.

    M x = G' y,    d/L . (rate of the links at v + x) = aim  (y = 0 of links that stretch)

y are the impulses [N s] that cause the change. A midpoint scheme enforces lengths, not their rates. A velocity along a
link, caused by a jump of a prescribed point (its velocity or acceleration), therefore changes sign at every step and
never decays, and tensions alternate by `2 m w/h`. Steps that contain a jump end with this projection. A
smooth motion of the scheme has `d . d' = h^2 d' . d''/4` at the ends of its steps, which `w1 = -w0 + h^2 d' . d''/2`
leaves unchanged. The target rate of the links is this value rather than zero.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.scipy.linalg import lu_factor, lu_solve

from dropper_jax.base.numerics import dot
from dropper_jax.model import AddedMass, Kinematics, Law, Model
from dropper_jax.residual import StepProblem, Unknowns, couples_inertia
from dropper_jax.solvers import SOLVERS


class ProjectionProblem(StepProblem):
    """Unknowns: x, the change of velocities (nodes, 3) [m/s], and impulses y (n,) [N s]; linear."""

    pieces = ()  # the forces in the rows do not depend on the unknowns

    def __init__(self, k: Kinematics, added: bool) -> None:
        self.model, self.h = k.model, jnp.ones((), k.r.dtype)
        # step [s] over which the inertia of added mass is evaluated at an instant, because it is a difference over a
        # step. The truncation error is of second order, the rounding error is 1e-12 of its inverse
        self.k, self.added = k.over(1e-4) if added else k, added
        self.link_direction = k.links / k.line.length[:, None]
        self.rigid = k.line.axial.rigid(k.line.links)
        #: Target rate of stretch per length of rigid links, and impulses of others.
        self.aim = self.law = jnp.zeros((), k.r.dtype)

    def _inertia(self, x: jax.Array) -> jax.Array:
        if not self.added:
            return self.model.nodal_inertia(x)
        return self.model.inertia(self.k, x) - self.model.inertia(self.k, jnp.zeros_like(x))

    def node_rows(self, x: jax.Array, z: tuple[jax.Array, ...]) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        return self._inertia(x), ()

    def link_vectors(self, x: jax.Array) -> jax.Array:
        """Rates of the links, for the network solver."""
        return self.model.rates(self.k.v + x, self.k.ends)

    def link_rows(self, d: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        rows = jnp.sum(self.link_direction * d, axis=-1) - self.aim
        return y[:, None] * self.link_direction, rows if self.rigid.all() else jnp.where(self.rigid, rows, self.law - y)


class InstantProblem(ProjectionProblem):
    """Unknowns: accelerations (nodes, 3) [m/s^2] and tensions (n,) [N] at one instant; linear.

    M a = F + G' T,    d . d'' + |d'|^2 = 0 of rigid links,    T by the law of those that stretch
    """

    def __init__(self, k: Kinematics, end_acceleration: jax.Array | None) -> None:
        super().__init__(k, bool(k.model.having(AddedMass)))
        line = k.line
        self.moved, self.force = end_acceleration, k.model.force(k)
        self.aim = -jnp.sum(k.link_velocities**2, axis=-1) / line.length
        if not self.rigid.all():
            self.law = line.axial.tension(k.links, k.link_velocities, line.length)
            self.link_direction = jnp.where(self.rigid[:, None], self.link_direction, k.tangents)

    def _inertia(self, x: jax.Array) -> jax.Array:
        return self.model.inertia(self.k, x, self.moved)

    def node_rows(self, x: jax.Array, z: tuple[jax.Array, ...]) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        return self._inertia(x) - self.force, ()

    def link_vectors(self, x: jax.Array) -> jax.Array:
        return self.model.geometry.differences(x, self.moved)


def consistent(k: Kinematics, added: bool = False, aim: jax.Array | None = None) -> tuple[jax.Array, jax.Array]:
    """Velocities (nodes, 3) [m/s] on the constraints, and the impulses (n,) [N s] that lead there.

    Args:
        k: positions, velocities and fixed points of one instant; with `added` prepared, as added mass requires.
        added: whether added mass is included.
        aim: target rate of stretch per length of rigid links, (n,) [1/s]; default zero.
    """
    problem = ProjectionProblem(k, added and bool(k.model.having(AddedMass)))
    if aim is not None:
        problem.aim = aim
    change, impulse, _ = _solve_projection(problem)
    return k.v + change, impulse


def instant(k: Kinematics, end_acceleration: jax.Array | None = None) -> tuple[jax.Array, jax.Array]:
    """Accelerations (nodes, 3) [m/s^2] and tensions (n,) [N] at one instant, without laws that have their own unknowns.

    Args:
        k: prepared (`Model.instant`).
        end_acceleration: accelerations of moving ends, (held, 3) [m/s^2].
    """
    a, tension, _ = _solve_projection(InstantProblem(k, end_acceleration))
    return a, tension


def _solve_projection(problem: ProjectionProblem) -> Unknowns:
    k = problem.k
    model = problem.model
    u = Unknowns(jnp.zeros_like(k.r), jnp.zeros_like(k.line.length))
    coupled = k.line.compound or (problem.added and couples_inertia(model))
    solver = SOLVERS["network" if not model.geometry.is_path else "banded" if coupled else "condensed"]
    found = solver.linearise(problem, u).apply(problem.residual(u))
    return Unknowns(-found.x, -found.y)


def jumps(model: Model, t: jax.Array, h: jax.Array) -> jax.Array | None:
    """Whether prescribed points jump in a step from t: within it or at either end; None if they never do."""
    kinks = model.kinks
    if kinks is None or model.line.axial.elastic:
        return None
    near = 1e-6 * jnp.abs(h)
    low = jnp.minimum(t, t + h) - near
    high = jnp.maximum(t, t + h) + near
    return jnp.any((kinks >= low) & (kinks <= high))


def sawtooth_grows(model: Model) -> bool:
    """Whether something may excite velocities along rigid links that change sign at every step.

    Added mass of Morison's form turns with its link and contributes `1/2 v' M_a' v`. Such a velocity grew from rounding
    error to ten times all others within ten minutes of a regular wave, for any step.
    """
    return not model.line.axial.elastic and bool(_turning(model))


def feeds_sawtooth(model: Model) -> jax.Array:
    """Whether it actually does so, according to its coefficients."""
    return jnp.any(jnp.stack([e.differs for e in _turning(model)]))


def _turning(model: Model) -> list[AddedMass]:
    return [e for e in model.having(AddedMass) if e.turns]


def after_jump(k: Kinematics, end_acceleration: jax.Array, h: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Velocities (nodes, 3) [m/s] from which midpoint steps of h continue smoothly, and impulses (n,) [N s] to them."""
    v, first = consistent(k, added=True)
    k = k.with_velocity(v)
    a, _ = instant(k, end_acceleration)
    bend = jnp.sum(k.link_velocities * k.model.geometry.differences(a, end_acceleration), axis=-1)
    v, second = consistent(k, True, 0.25 * h**2 * bend / k.line.length)
    return v, first + second


def after_change_of_step(
    k: Kinematics, acceleration: jax.Array, end_acceleration: jax.Array | None, h: jax.Array
) -> jax.Array:
    """Velocities (nodes, 3) [m/s] from which midpoint steps of h continue smoothly after one of another length.

    The smooth rates `d . d' = h^2 d' . d''/4` belong to a length of steps. With those of a step h0 rates along rigid
    links change sign at every step, and tensions alternate by `m (h0^2 - h^2)/h d' . d''/2` for ever. The energy of
    the change is of fourth order in the steps.

    Args:
        acceleration: of the nodes over the last step (nodes, 3) [m/s^2].
        end_acceleration: of moving ends (held, 3) [m/s^2].
    """
    bend = jnp.sum(k.link_velocities * k.model.geometry.differences(acceleration, end_acceleration), axis=-1)
    return consistent(k, True, 0.25 * h**2 * bend / k.line.length)[0]


def consistent_velocity(model: Model, r: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
    """Velocities (nodes, 3) [m/s] at the start of a run: if ends move at once, velocities that the links can have."""
    if model.line.axial.elastic:
        return v
    return consistent(model.instant(r, v, t), added=True)[0]


# Friction at the end of a step, on joints that were stuck at its middle: it stops them.
#
# A law on the mid-step rate holds a joint by `w_mid = 0`, which turns its rate w0 into `-w0` at every step. The end
# velocities of such a step are therefore changed by impulses P of the stuck joints (and pi of the tensions), within
# the limit of friction over the step:
#
#     M delta = B' P + G' pi,    B (v1 + delta) = 0 on stuck joints,    |h z + P| <= h tau
#
# In the mass metric this is a projection, so it takes kinetic energy and never adds any (Moreau 1988). The energy
# that it takes is work of the law. If the bound is reached, the impulse stays on it and the joint keeps moving.

#: One array per law.
Joints = tuple[jax.Array, ...]


def stop_held_joints(
    model: Model, z: tuple[jax.Array, ...], middle: Kinematics, after: Kinematics, h: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """End velocities (nodes, 3) [m/s] with stuck joints at rest, and the work of that (<= 0) [J].

    Args:
        z: the laws' unknowns over the step.
        middle, after: the middle and the end of the step.
        h: the step [s].
    """
    held = tuple(law.holding(middle, torque, h) for law, torque in zip(model.laws, z, strict=True))
    some = jnp.any(jnp.stack([jnp.any(one) for one in held]))
    # most steps have no stuck joint, and then none of this is executed
    stopped = partial(_stop_nodes, model, held, z, after.with_velocity(after.v), h)
    return jax.lax.cond(some, stopped, lambda: (after.v, jnp.zeros((), after.v.dtype)))


def _stop_nodes(model: Model, held: Joints, z: Joints, after: Kinematics, h: jax.Array) -> tuple[jax.Array, jax.Array]:
    # neither solution nor factors are differentiated: one more correction with differentiated rows has the exact
    # derivative of the solution, at the cost of a few operations
    u, factor, over, aim = _solve(*jax.lax.stop_gradient((model, held, after.v, after.r, after.t, z, h)))
    rows = ravel_pytree(_rows(model, held, after, z, h, over, aim, u))[0]
    flat, unravel = ravel_pytree(u)
    return _falling(model, after, unravel(flat - lu_solve(factor, rows)).x)


def stop_held_nodes(
    model: Model, z: tuple[jax.Array, ...], middle: Kinematics, after: Kinematics, h: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The same for laws that hold nodes individually (`node_local`): each simply stops, as its `stop` defines."""
    v1 = after.v
    for law, held in zip(model.laws, z, strict=True):
        v1 = law.stop(middle, v1, held, h)
    return v1, model.kinetic_energy(after.with_velocity(v1)) - model.kinetic_energy(after)


@jax.jit  # traced once, not at each of the half dozen positions of a differentiated step
def _solve(
    model: Model, held: Joints, v: jax.Array, r: jax.Array, t: jax.Array, z: Joints, h: jax.Array
) -> tuple[Unknowns, Joints, Joints, Joints]:
    """Unknowns, factors of their matrix, the joints whose impulse is on its bound, and the direction of their
    impulses."""
    after = model.kinematics(r, v, t)
    zero = Unknowns(jnp.zeros_like(v), jnp.zeros_like(model.line.length), tuple(jnp.zeros_like(q) for q in z))
    flat, unravel = ravel_pytree(zero)

    def correct(carry: tuple[Any, ...], _: None) -> tuple[tuple[Any, ...], None]:
        x, _, over, aim = carry
        plain = lambda x: ravel_pytree(_rows(model, held, after, z, h, over, aim, unravel(x)))[0]  # noqa: E731
        factor = lu_factor(jax.jacfwd(plain)(x))
        x = x - lu_solve(factor, plain(x))
        found = tuple(zip(model.laws, held, over, unravel(x).z, z, strict=True))
        beyond = tuple(one & ~o & _beyond(law, p, q, h) for law, one, o, p, q in found)
        # doubled, so that its nearest allowed torque is on the bound despite rounding
        aim = tuple(jnp.where(b, 2.0 * (p / h + q), a) for b, a, (*_, p, q) in zip(beyond, aim, found, strict=True))
        return (x, factor, tuple(o | b for o, b in zip(over, beyond, strict=True)), aim), None

    nothing = tuple(jnp.zeros_like(one) for one in held)
    start = flat, lu_factor(jnp.eye(len(flat), dtype=flat.dtype)), nothing, zero.z
    # Newton corrections: the first is exact if no impulse reaches its bound. A joint that reaches its bound in the last
    # one keeps more than its part of one step. That affects the accuracy of this event, never the energy
    x, factor, over, aim = jax.lax.scan(correct, start, None, length=3)[0]
    return unravel(x), factor, over, aim


def _beyond(law: Law, p: jax.Array, q: jax.Array, h: jax.Array) -> jax.Array:
    """Joints (joints, 1) whose impulse exceeds its bound; within the bound both differ by rounding of p and h q.

    A joint wrongly classified as exceeding its bound would have a row of zeros.
    """
    size = jnp.max(jnp.abs(p) + jnp.abs(h * q), axis=-1, keepdims=True)
    # the impulse nearest to p that keeps `h q + p`, friction's impulse over the full step, within its bound
    nearest = h * law.admissible(p / h + q) - h * q
    return jnp.max(jnp.abs(p - nearest), axis=-1, keepdims=True) > 1e-9 * size


def _rows(
    model: Model, held: Joints, after: Kinematics, z: Joints, h: jax.Array, over: Joints, aim: Joints, u: Unknowns
) -> Unknowns:
    """Rows of the system above for velocity changes, impulses of tensions and of joints.

    An impulse that exceeds its bound stays on it and keeps its direction. Otherwise all points of the bound would be
    solutions, and a row with free direction would be singular.
    """
    line = model.line
    scale = jnp.mean(line.mass * line.length**2)
    moved = after.with_velocity(after.v + u.x)
    force = model.inertia(after, u.x) - model.tension_force(u.y, after.tangents)
    for law, p in zip(model.laws, u.z, strict=True):
        force = force - law.law_force(after, p)
    along = u.y
    if not line.axial.elastic:
        rate = jnp.where(_both_held(model, held)[:, None], moved.link_velocities, model.rates(u.x, None))
        along = jnp.mean(line.mass) * dot(after.tangents, rate)
    # relative compliance of the impulses: there may be more stuck joints than motions that they stop (8 joints, 5
    # motions of a plane loop of 7 links), and the distribution of the load is then arbitrary
    rest = tuple(scale * law.rates(moved) + 1e-10 * p for law, p in zip(model.laws, u.z, strict=True))
    bound = tuple(p - h * (law.admissible(a) - q) for law, p, q, a in zip(model.laws, u.z, z, aim, strict=True))
    joints = tuple(
        jnp.where(one & ~o, a, jnp.where(o, b, p)) for one, o, a, b, p in zip(held, over, rest, bound, u.z, strict=True)
    )
    return Unknowns(force, along, joints)


def _both_held(model: Model, held: tuple[jax.Array, ...]) -> jax.Array:
    """Links (n,) whose two joints are stuck by one law: they stop completely, including their rate of length."""
    links = model.line.links
    both = jnp.zeros(links, bool)
    for one in held:
        if one.shape[0] > links:
            both = both | (one[:-1, 0] & one[1:, 0])
    return both


def _falling(model: Model, after: Kinematics, delta: jax.Array) -> tuple[jax.Array, jax.Array]:
    """`v + s delta` with the s in [0, 1] of minimum kinetic energy (1 if delta is a projection), and its change."""
    weight = jnp.sum(delta * model.inertia(after, delta))
    slope = jnp.sum(delta * model.inertia(after, after.v))
    # below the normal numbers a quotient is 0/0 if the processor flushes them; nothing moves any more at that scale
    moves = weight > 1e3 * jnp.finfo(weight.dtype).tiny
    share = jnp.clip(-slope / jnp.where(moves, weight, 1.0), 0.0, 1.0)
    share = jnp.where(moves, share, 0.0)
    return after.v + share * delta, share * (slope + 0.5 * share * weight)
