"""Semi-implicit (symplectic) Euler, the thesis' scheme for the single and the double pendulum (2.35).

    M (v1 - v0)/h = F(r0, v0, t0) + G(r0)' T,    r1 = r0 + h v1,    constraint at r1

(The thesis prints explicit Euler in (2.36)-(2.37) where this scheme is meant; erratum.)

On lines that stretch, tensions follow from lengths and no system has to be solved (the paper's section on its schemes):

    M (v1 - v0)/h = F(r0, v0, t0) + tensions at (r0, v0),    r1 = r0 + h v1
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from dropper_jax.integrators.runge_kutta import combine, rates
from dropper_jax.model import Model, State, book_works
from dropper_jax.residual import (
    CondensedParts,
    Explicit,
    Implicit,
    Integrator,
    SpeedProblem,
    Unknowns,
    point_masses_only,
)


@dataclass(frozen=True)
class SemiImplicitEuler(Implicit):
    """First order; explicit forces, tensions that enforce the new lengths."""

    name: ClassVar[str] = "semi_implicit_euler"
    order: ClassVar[int] = 1
    condensable: ClassVar[bool] = True
    iterations: ClassVar[int] = 4
    condensed_iterations: ClassVar[int] = 4

    def form_for(self, model: Model) -> Integrator:
        return ElasticSemiImplicitEuler() if model.line.axial.elastic else self

    def refuse(self, model: Model) -> str | None:
        return point_masses_only(model) or super().refuse(model)

    def equations(self, model: Model, s: State, h: jax.Array) -> SemiImplicitProblem:
        return SemiImplicitProblem(model, s, h)


@dataclass(frozen=True)
class ElasticSemiImplicitEuler(Explicit):
    """The same for lines that stretch: explicit, first order, stable for `h omega < 2` without damping."""

    name: ClassVar[str] = SemiImplicitEuler.name
    order: ClassVar[int] = 1

    def advance(self, model: Model, s: State, h: jax.Array) -> State:
        (_, a, power), _ = rates(model, s.r, s.v, s.t, bool(s.work.size))
        return combine(model, s, h, (s.v + h * a, a, power))


class SemiImplicitProblem(SpeedProblem):
    """Unknowns: x = v1, y = T."""

    def __init__(self, model: Model, s: State, h: jax.Array) -> None:
        super().__init__(model, s, h)
        self.before = model.instant(s.r, s.v, s.t, self.ends0)
        self.force0 = model.force(self.before)

    def guess(self) -> Unknowns:
        return Unknowns(self.s.v + self.h * self.s.acceleration, self.s.tension)

    def _links1(self, v1: jax.Array) -> jax.Array:
        return self.model.links(self.s.r + self.h * v1, self.ends1)

    def residual(self, u: Unknowns) -> Unknowns:
        line, links1 = self.model.line, self._links1(u.x)
        force = self.mass[:, None] * (u.x - self.s.v) / self.h - self.force0 - self.model.tension_force(u.y, self.pull0)
        return Unknowns(force, line.axial.at_rest(links1, u.y, line.length))

    def node_matrix(self, u: Unknowns) -> jax.Array:
        return self.mass / self.h

    def condensed_parts(self, u: Unknowns) -> CondensedParts:
        return CondensedParts(self.pull0, self.unit_forces(self.h * self._links1(u.x)), jnp.zeros_like(u.y))

    def finish(self, u: Unknowns, evaluated: Any = None) -> State:
        s, h = self.s, self.h
        return self.end_state(
            r=s.r + h * u.x,
            v=u.x,
            tension=u.y,
            acceleration=jax.lax.stop_gradient((u.x - s.v) / h),
            work=lambda: self._work(u),
        )

    def _work(self, u: Unknowns) -> jax.Array:
        model, h = self.model, self.h
        works = {name: h * jnp.sum(force * u.x) for name, force in model.working_forces(self.before).items()}
        ends = model.end_powers(u.y[:, None] * self.pull0, self.ends1, self.before)
        return book_works(model, works, {name: h * power for name, power in ends.items()})
