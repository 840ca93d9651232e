"""The thesis' own scheme, retained as the baseline of comparisons: angles, rates and tensions of every link.

Unknowns per link (theta, phi, their rates, T), rows (C.32)-(C.41) with the weighting (5.4):

    (theta1 - theta0)/h = gamma theta'1 + (1 - gamma) theta'0, the same for phi
    m_n [A_n + gamma B_n1 + (1 - gamma) B_n0] = gamma F_n1 + (1 - gamma) F_n0        (free nodes)
    end of the last link = fixed point                                               (closed loop)

A_n sums the links' terms in theta'', phi'' (differences of the rates, at the new angles), B_n those in theta'^2,
phi'^2, theta' phi', both from the links before node n. Corrected: the sign of B and of its Coriolis part, the missing
m_n, z downwards positive angle (errata on (4.19), (C.8)-(C.17), (C.33)-(C.36)). Angles are from the horizontal. A
vertical link has no azimuth, and the Jacobian is singular there; the scheme is kept to demonstrate this.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.fields import parameter
from dropper_jax.model import Ends, Kinematics, Model, State, book_works
from dropper_jax.residual import GRAVITY_SCALE, Implicit, StepProblem, Unknowns


@dataclass(frozen=True)
class ThesisAngles(Implicit):
    """First order (gamma = 0.5 formally second); dense Newton on 5 unknowns per link."""

    name = "thesis_angles"
    order = 1
    local_rows = False
    point_masses = True
    gamma: float = parameter(
        "weight of the new time, 1 for implicit Euler", unit="-", above=0.0, high=1.0, default=0.51
    )

    @property
    def dissipates(self) -> bool:
        return self.gamma > 0.5

    def refuse(self, model: Model) -> str | None:
        if model.has_moving_ends:
            return "the thesis' scheme holds both ends still; use energy_momentum"
        return super().refuse(model)

    def equations(self, model: Model, s: State, h: Array) -> AnglesProblem:
        return AnglesProblem(model, s, h, self.gamma)

    def begin(self, model: Model, s: State) -> State:
        return replace(s, angles=angles_of_state(model, s))


#: A vertical link has no azimuth: its rate is left at zero, which is an inherent defect of the scheme.
VERTICAL_COSINE = 1e-9


def angles_of_state(model: Model, s: State) -> tuple[Array, ...]:
    """The angles that the state carries, or those that correspond to its positions and velocities."""
    if s.angles is not None:
        return s.angles
    return angles_of_links(model.links(s.r, model.ends(s.t)), model.link_rates(s.v, None))


def angles_of_links(d: Array, rate: Array) -> tuple[Array, ...]:
    """theta, phi, theta', phi' (n,) of link vectors d and their rates (n, 3), planar links with phi = 0."""
    planar = jnp.all(jnp.abs(d[:, 1]) <= 1e-12 * jnp.max(jnp.abs(d)))
    # both are finite, with finite derivatives, of a vertical link of a planar line too, which does not use them
    x = jnp.where(planar, 1.0, d[:, 0])
    across = jnp.where(planar, d[:, 0], jnp.sqrt(x**2 + d[:, 1] ** 2))
    theta = jnp.arctan2(-d[:, 2], across)
    phi = jnp.where(planar, 0.0, jnp.arctan2(d[:, 1], x))
    length = jnp.sqrt(jnp.sum(d * d, axis=-1))
    polar = jnp.stack([-jnp.sin(theta) * jnp.cos(phi), -jnp.sin(theta) * jnp.sin(phi), -jnp.cos(theta)], -1)
    round_ = jnp.stack([-jnp.sin(phi), jnp.cos(phi), jnp.zeros_like(phi)], -1)
    flat = jnp.cos(theta)
    has_azimuth = jnp.abs(flat) > VERTICAL_COSINE
    azimuth_rate = jnp.where(
        has_azimuth, jnp.sum(rate * round_, -1) / (length * jnp.where(has_azimuth, flat, 1.0)), 0.0
    )
    return theta, phi, jnp.sum(rate * polar, -1) / length, azimuth_rate


def _unit(theta: Array, phi: Array) -> Array:
    """Unit vectors (n, 3) of links at these angles (n,) [rad]."""
    return jnp.stack([jnp.cos(theta) * jnp.cos(phi), jnp.cos(theta) * jnp.sin(phi), -jnp.sin(theta)], -1)


class AnglesInstant(NamedTuple):
    """One instant of the scheme.

    Attributes:
        k: positions and velocities.
        end: the last link's end (3,) [m].
        bend: centripetal and Coriolis accelerations (n, 3) [m/s^2] of the links' ends.
        force: with tensions (nodes, 3) [N].
    """

    k: Kinematics
    end: Array
    bend: Array
    force: Array


class AnglesProblem(StepProblem):
    """Unknowns: x = (theta, phi, theta', phi') of the new time (n, 4), y = T.

    If the state does not carry the angles, each step computes them from the positions.
    """

    def __init__(self, model: Model, s: State, h: Array, gamma: float | Array) -> None:
        super().__init__(model, s, h)
        self.gamma = gamma
        #: x at the start of the step.
        self.x0 = jnp.stack(angles_of_state(model, s), -1)
        self.ends1 = model.ends(s.t + h)
        self.mass = model.line.mass[: model.free_nodes, None]
        self.old = self._instant(self.x0, s.t, model.ends(s.t), s.tension)

    def guess(self) -> Unknowns:
        angles = self.x0[:, :2]
        rates = self.x0[:, 2:]
        return Unknowns(jnp.concatenate([angles + self.h * rates, rates], axis=1), self.s.tension)

    def _instant(self, x: Array, t: Array, ends: Ends, tension: Array) -> AnglesInstant:
        """The instant of angles and rates x (n, 4) and tensions (n,) [N]."""
        length = self.model.line.length[:, None]
        theta, phi, *rate = x.T

        def unit_and_rate(theta: Array, phi: Array) -> tuple[Array, Array]:
            return jax.jvp(_unit, (theta, phi), tuple(rate))

        (unit, unit_rate), (_, bend) = jax.jvp(unit_and_rate, (theta, phi), tuple(rate))
        v = jnp.cumsum(length * unit_rate, axis=0)
        b = jnp.cumsum(length * bend, axis=0)
        r = ends.start + jnp.cumsum(length * unit, axis=0)
        free = self.model.free_nodes
        k = self.model.instant(r[:free], v[:free], t, ends)
        return AnglesInstant(k, r[-1], b, self.model.force(k) + self.model.tension_force(tension, unit))

    def residual(self, u: Unknowns) -> Unknowns:
        h = self.h
        gamma = self.gamma
        length = self.model.line.length
        angles = u.x[:, :2]
        rates = u.x[:, 2:]
        old_rates = self.x0[:, 2:]
        kinematic = (angles - self.x0[:, :2]) / h - gamma * rates - (1 - gamma) * old_rates
        new = self._instant(u.x, self.s.t + h, self.ends1, u.y)
        a = jax.jvp(_unit, tuple(angles.T), tuple(((rates - old_rates) / h).T))[1]
        a = jnp.cumsum(length[:, None] * a, axis=0)
        b = gamma * new.bend + (1 - gamma) * self.old.bend
        inertia = self.mass * (a + b)[: self.model.free_nodes]
        rows = inertia - gamma * new.force - (1 - gamma) * self.old.force
        end = self.ends1.end
        if end is not None:
            rows = jnp.concatenate([rows, (new.end - end)[None] * (self._force()[-1] / length[-1])])
        # kinematic rows are rates times the ratio of the force scale to a rate, so that one tolerance serves all rows
        return Unknowns(jnp.concatenate([kinematic * h * self._force(), rows[:, :2]], 1), rows[:, 2])

    def _force(self) -> Array:
        """Size of the force rows (n, 1) [N]: max(m g, m L/h^2)."""
        line = self.model.line
        return (line.mass * jnp.maximum(GRAVITY_SCALE, line.length / self.h**2))[:, None]

    def row_scale(self) -> Unknowns:
        force = self._force()
        return Unknowns(force, force[:, 0])

    def column_scale(self) -> Unknowns:
        rate = 1 / jnp.abs(self.h)
        return Unknowns(jnp.stack([jnp.ones_like(rate), jnp.ones_like(rate), rate, rate]), self._force()[:, 0])

    def finish(self, u: Unknowns) -> State:
        after = self._instant(u.x, self.s.t + self.h, self.ends1, u.y).k
        angles = None
        if self.s.angles is not None:
            angles = tuple(u.x.T)
        return self.end_state(after.r, after.v, u.y, lambda: self._work(self.old.k, after), angles=angles)

    def _work(self, before: Kinematics, after: Kinematics) -> Array:
        gamma = self.gamma
        mean = gamma * after.v + (1 - gamma) * before.v
        return book_works(self.model, self.force_works(after, mean, gamma), self.force_works(before, mean, 1 - gamma))
