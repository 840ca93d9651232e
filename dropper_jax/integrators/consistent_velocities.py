"""Velocities that are consistent with rigid links: the smallest change, in the mass metric, to given rates of stretch.

    M x = G' y,    d/L . (rate of the links at v + x) = stretch_rate  (y = 0 of links that stretch)

y are the impulses [N s] that cause the change, positive in tension. A midpoint scheme enforces lengths, not their
rates. A velocity along a link, caused by a jump of a prescribed point (its velocity or acceleration), therefore changes
sign at every step and never decays, and tensions alternate by `2 m w/h`. Steps that contain a jump end with this
projection. A smooth motion of the scheme has `d . d' = h^2 d' . d''/4` at the ends of its steps, which `w1 = -w0 + h^2
d' . d''/2` leaves unchanged. The rate `stretch_rate` of the links is this value rather than zero.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from dropper_jax.model import AddedMass, Kinematics, Model, TurningMass
from dropper_jax.residual import NodeRows, PerLaw, StepProblem, Unknowns, couples_inertia
from dropper_jax.solvers import SOLVERS

#: Step [s] over which the inertia of added mass is evaluated at an instant, because it is a difference over a step. The
#: truncation error is of second order, the rounding error is 1e-12 of its inverse.
INERTIA_STEP = 1e-4


class ProjectionProblem(StepProblem):
    """Unknowns: x, the change of velocities (nodes, 3) [m/s], and impulses y (n,) [N s]; linear."""

    pieces = ()  # the forces in the rows do not depend on the unknowns

    def __init__(self, k: Kinematics, added: bool) -> None:
        self.model = k.model
        self.h = jnp.ones((), k.r.dtype)
        self.k = k
        self.added = added
        #: Accelerations (held, 3) [m/s^2] of the fixed points; None if they do not accelerate.
        self.end_acceleration: Array | None = None
        self.force: Array | float = 0.0
        if added:
            self.k = k.over(INERTIA_STEP)
            self.force = self.model.inertia(self.k, jnp.zeros_like(k.r))
        self.link_direction = k.links / k.line.length[:, None]
        self.rigid = k.line.axial.rigid(k.line.links)
        #: Rate of stretch per length [1/s] of rigid links after the change, and impulses [N s] of others.
        self.stretch_rate = jnp.zeros((), k.r.dtype)
        self.law = jnp.zeros((), k.r.dtype)

    def node_rows(self, x: Array, z: PerLaw) -> NodeRows:
        if self.added:
            inertia = self.model.inertia(self.k, x, self.end_acceleration)
        else:
            inertia = self.model.nodal_inertia(x, self.end_acceleration)
        return inertia - self.force, ()

    def link_vectors(self, x: Array) -> Array:
        """Rates of the links, for the network solver."""
        return self.model.geometry.differences(self.k.v + x, self.k.ends.velocities)

    def link_rows(self, d: Array, y: Array) -> tuple[Array, Array]:
        rows = jnp.sum(self.link_direction * d, axis=-1) - self.stretch_rate
        if not self.rigid.all():
            rows = jnp.where(self.rigid, rows, self.law - y)
        return y[:, None] * self.link_direction, rows


class InstantProblem(ProjectionProblem):
    """Unknowns: accelerations (nodes, 3) [m/s^2] and tensions (n,) [N] at one instant; linear.

    M a = F + G' T,    d . d'' + |d'|^2 = 0 of rigid links,    T by the law of those that stretch
    """

    def __init__(self, k: Kinematics, end_acceleration: Array | None) -> None:
        super().__init__(k, bool(k.model.effects_with(AddedMass)))
        line = k.line
        self.end_acceleration = end_acceleration
        self.force = k.model.force(k)
        self.stretch_rate = -jnp.sum(k.link_velocities**2, axis=-1) / line.length
        if not self.rigid.all():
            self.law = line.axial.tension(k.links, k.link_velocities, line.length)
            self.link_direction = jnp.where(self.rigid[:, None], self.link_direction, k.tangents)

    def link_vectors(self, x: Array) -> Array:
        return self.model.geometry.differences(x, self.end_acceleration)


def make_consistent(k: Kinematics, added: bool = False, stretch_rate: Array | None = None) -> tuple[Array, Array]:
    """Velocities (nodes, 3) [m/s] on the constraints, and the impulses (n,) [N s] that lead there.

    Args:
        k: positions, velocities and fixed points of one instant; with `added` prepared, as added mass requires.
        added: whether added mass is included.
        stretch_rate: rate of stretch per length of rigid links after the change, (n,) [1/s]; default zero.
    """
    problem = ProjectionProblem(k, added and bool(k.model.effects_with(AddedMass)))
    if stretch_rate is not None:
        problem.stretch_rate = stretch_rate
    change, impulse, _ = _solve_projection(problem)
    return k.v + change, impulse


def solve_instant(k: Kinematics, end_acceleration: Array | None) -> tuple[Array, Array]:
    """Accelerations (nodes, 3) [m/s^2] and tensions (n,) [N] at one instant, without laws that have their own unknowns.

    Args:
        k: prepared (`Model.instant`).
        end_acceleration: accelerations of moving ends, (held, 3) [m/s^2].
    """
    a, tension, _ = _solve_projection(InstantProblem(k, end_acceleration))
    return a, tension


def _solve_projection(problem: ProjectionProblem) -> Unknowns:
    """The solution of a linear problem, by one correction from zero with a matrix that is exact for its rows."""
    k = problem.k
    model = problem.model
    u = Unknowns(jnp.zeros_like(k.r), jnp.zeros_like(k.line.length))
    solver = "condensed"
    if not model.geometry.is_path:
        solver = "network"
    elif k.line.compound or (problem.added and couples_inertia(model)):
        solver = "banded"
    found = SOLVERS[solver].linearise(problem, u).apply(problem.residual(u))
    return Unknowns(-found.x, -found.y)


def points_jump(model: Model, t: Array, h: Array) -> Array | None:
    """Whether prescribed points jump in a step from t: within it or at either end; None if they never do."""
    kinks = model.kinks
    if kinks is None or model.line.axial.elastic:
        return None
    near = 1e-6 * jnp.abs(h)
    low = jnp.minimum(t, t + h) - near
    high = jnp.maximum(t, t + h) + near
    return jnp.any((kinks >= low) & (kinks <= high))


def sawtooth_grows(model: Model) -> Array | None:
    """Whether something excites velocities along rigid links that change sign at every step; None if nothing may.

    Added mass of Morison's form turns with its link and contributes `1/2 v' M_a' v`. Such a velocity grew from rounding
    error to ten times all others within ten minutes of a regular wave, for any step.
    """
    turning = [e for e in model.effects_with(TurningMass) if e.may_gain_energy]
    if model.line.axial.elastic or not turning:
        return None
    return jnp.any(jnp.stack([e.gains_energy() for e in turning]))


def velocities_after_jump(k: Kinematics, end_acceleration: Array | None, h: Array) -> tuple[Array, Array]:
    """Velocities (nodes, 3) [m/s] from which midpoint steps of h continue smoothly, and impulses (n,) [N s] to them."""
    v, first = make_consistent(k, added=True)
    k = k.with_velocity(v)
    v, second = velocities_after_step_change(k, solve_instant(k, end_acceleration)[0], end_acceleration, h)
    return v, first + second


def velocities_after_step_change(
    k: Kinematics, acceleration: Array, end_acceleration: Array | None, h: Array
) -> tuple[Array, Array]:
    """The same after a step of another length.

    The smooth rates `d . d' = h^2 d' . d''/4` belong to a length of steps. With those of a step h0 rates along rigid
    links change sign at every step, and tensions alternate by `m (h0^2 - h^2)/h d' . d''/2` indefinitely. The energy of
    the change is of fourth order in the steps.

    Args:
        acceleration: of the nodes over the last step (nodes, 3) [m/s^2].
        end_acceleration: of moving ends (held, 3) [m/s^2].
    """
    bend = jnp.sum(k.link_velocities * k.model.geometry.differences(acceleration, end_acceleration), axis=-1)
    return make_consistent(k, True, 0.25 * h**2 * bend / k.line.length)


def initial_velocity(model: Model, r: Array, v: Array, t: Array) -> Array:
    """Velocities (nodes, 3) [m/s] at the start of a run: if ends move at once, velocities that the links can have."""
    if model.line.axial.elastic:
        return v
    return make_consistent(model.instant(r, v, t), added=True)[0]
