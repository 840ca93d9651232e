"""RATTLE: half kick, drift, half kick, with position and velocity constraints (Andersen 1983). The fastest scheme.

    2 M (v_h - v0)/h = F(r0, v_h, t0) + G(r0)' lambda,    r1 = r0 + h v_h,    constraint at r1
    2 M (v1 - v_h)/h = F(r1, v_h, t1) + G(r1)' mu,        velocity constraint at r1

The second half is the adjoint of the first (forces use the same v_h), so the scheme is symmetric and second order with
velocity-dependent forces too, and symplectic without them. Its energy error is bounded while h omega < 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
from jax import Array

from dropper_jax.base.numerics import dot
from dropper_jax.model import Kinematics, Model, State, book_works
from dropper_jax.residual import Implicit, NodeRows, PerLaw, SpeedProblem, Unknowns
from dropper_jax.solvers.condensed import solve_multipliers


@dataclass(frozen=True)
class Rattle(Implicit):
    """RATTLE, second order, symplectic."""

    name = "rattle"
    order = 2
    condensable = True
    point_masses = True
    enough = 1.0  # its energy is bounded by the scheme, not conserved to rounding

    def equations(self, model: Model, s: State, h: Array) -> RattleProblem:
        return RattleProblem(model, s, h)


class RattleProblem(SpeedProblem):
    """Unknowns: x = v_h, y = lambda, the tensions of the first half."""

    def __init__(self, model: Model, s: State, h: Array) -> None:
        super().__init__(model, s, h)
        self.prepared = model.prepare(model.kinematics(s.r, s.v, s.t, self.ends0))

    def guess(self) -> Unknowns:
        return Unknowns(self.s.v + 0.5 * self.h * self.s.acceleration, self.s.tension)

    def _start_kinematics(self, v: Array) -> Kinematics:
        return self.model.kinematics(self.s.r, v, self.s.t, self.ends0, prepared=self.prepared)

    def node_rows(self, x: Array, z: PerLaw) -> NodeRows:
        return (2 / self.h) * self.mass[:, None] * (x - self.s.v) - self.model.force(self._start_kinematics(x)), ()

    def finish(self, u: Unknowns) -> State:
        model = self.model
        h = self.h
        after = model.instant(self.s.r + h * u.x, u.x, self.s.t + h, self.ends1)
        pull1 = self.unit_forces(after.links)
        loose = u.x + 0.5 * h * model.force(after) / self.mass[:, None]
        # d1 . (rate of the links) = 0 after the second half kick
        mu = solve_multipliers(pull1, 0.5 * h / self.mass, dot(pull1, model.link_rates(loose, self.ends1)))
        v1 = loose + 0.5 * h * model.tension_force(mu, pull1) / self.mass[:, None]
        # the next half step has the same nodal forces, and tensions that continue from these
        onward = 2 * (v1 - u.x) / h + model.tension_force(mu - u.y, pull1) / self.mass[:, None]
        return self.end_state(
            r=after.r,
            v=v1,
            tension=mu,
            acceleration=jax.lax.stop_gradient(onward),
            work=lambda: self._work(u, after, pull1, mu),
        )

    def _work(self, u: Unknowns, after: Kinematics, pull1: Array, mu: Array) -> Array:
        return book_works(
            self.model,
            self.force_works(self._start_kinematics(u.x), u.x, 0.5),
            self.force_works(after, u.x, 0.5),
            self.end_works(u.y[:, None] * self.pull0, self.ends0, 0.5),
            self.end_works(mu[:, None] * pull1, self.ends1, 0.5),
        )
