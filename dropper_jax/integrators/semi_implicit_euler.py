"""Semi-implicit (symplectic) Euler, the thesis' scheme for the single and the double pendulum (2.35).

    M (v1 - v0)/h = F(r0, v0, t0) + G(r0)' T,    r1 = r0 + h v1,    constraint at r1

(The thesis prints explicit Euler in (2.36)-(2.37) where this scheme is meant; erratum.)

On lines that stretch, tensions follow from lengths and no system has to be solved (the paper's section on its schemes):

    M (v1 - v0)/h = F(r0, v0, t0) + tensions at (r0, v0),    r1 = r0 + h v1
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
from jax import Array

from dropper_jax.integrators.runge_kutta import combine, rates
from dropper_jax.model import Model, State, book_works
from dropper_jax.residual import Explicit, Implicit, Integrator, NodeRows, PerLaw, SpeedProblem, Unknowns


@dataclass(frozen=True)
class SemiImplicitEuler(Implicit):
    """First order; explicit forces, tensions that enforce the new lengths."""

    name = "semi_implicit_euler"
    order = 1
    condensable = True
    point_masses = True

    def form_for(self, model: Model) -> Integrator:
        if model.line.axial.elastic:
            return ElasticSemiImplicitEuler()
        return self

    def equations(self, model: Model, s: State, h: Array) -> SemiImplicitProblem:
        return SemiImplicitProblem(model, s, h)


@dataclass(frozen=True)
class ElasticSemiImplicitEuler(Explicit):
    """The same for lines that stretch: explicit, first order, stable for `h omega < 2` without damping."""

    name = SemiImplicitEuler.name
    order = 1

    def advance(self, model: Model, s: State, h: Array) -> State:
        (_, a, power), _ = rates(model, s.r, s.v, s.t, bool(s.work.size))
        return combine(model, s, h, (s.v + h * a, a, power))


class SemiImplicitProblem(SpeedProblem):
    """Unknowns: x = v1, y = T."""

    def __init__(self, model: Model, s: State, h: Array) -> None:
        super().__init__(model, s, h)
        self.before = model.instant(s.r, s.v, s.t, self.ends0)
        self.force0 = model.force(self.before)

    def guess(self) -> Unknowns:
        return Unknowns(self.s.v + self.h * self.s.acceleration, self.s.tension)

    def node_rows(self, x: Array, z: PerLaw) -> NodeRows:
        return self.mass[:, None] * (x - self.s.v) / self.h - self.force0, ()

    def finish(self, u: Unknowns) -> State:
        return self.end_state(
            r=self.s.r + self.h * u.x,
            v=u.x,
            tension=u.y,
            acceleration=jax.lax.stop_gradient((u.x - self.s.v) / self.h),
            work=lambda: self._work(u),
        )

    def _work(self, u: Unknowns) -> Array:
        ends = self.end_works(u.y[:, None] * self.pull0, self.ends1, k=self.before)
        return book_works(self.model, self.force_works(self.before, u.x), ends)
