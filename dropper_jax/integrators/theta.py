"""The thesis' weighting: forces and tensions of both ends of the step, weighted by gamma.

    M (v1 - v0)/h = gamma (F1 + G1' T1) + (1 - gamma) (F0 + G0' T0),    r1 = r0 + h (gamma v1 + (1 - gamma) v0)

with the constraint at r1. Gamma = 1 is implicit Euler, 0.51 the thesis (5.4). For gamma = 0, explicit Euler, r1 does
not depend on T1. The tension of the old time is then the one that makes the new velocity consistent with the constraint
at r1 (half-explicit Euler; Hairer and Wanner), and link lengths drift.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
from jax import Array

from dropper_jax.base.fields import parameter
from dropper_jax.base.numerics import dot
from dropper_jax.model import Kinematics, Model, State, book_works
from dropper_jax.residual import Implicit, NodeRows, PerLaw, SpeedProblem, Unknowns


@dataclass(frozen=True)
class Theta(Implicit):
    """End-point weighted scheme, first order (gamma = 0.5 is formally second and unstable in the tensions)."""

    name = "theta"
    order = 1
    condensable = True
    point_masses = True
    gamma: float = parameter(
        "weight of the new time, 0 for explicit, 1 for implicit Euler", unit="-", low=0.0, high=1.0, default=0.51
    )

    @property
    def holds_length(self) -> bool:
        return self.gamma > 0.0

    @property
    def dissipates(self) -> bool:
        return self.gamma > 0.5

    def equations(self, model: Model, s: State, h: Array) -> ThetaProblem:
        return ThetaProblem(model, s, h, self.gamma)


class ThetaProblem(SpeedProblem):
    """Unknowns: x = v1 - v0 and the tensions T1 (gamma = 0: T0)."""

    def __init__(self, model: Model, s: State, h: Array, gamma: float | Array) -> None:
        super().__init__(model, s, h)
        self.gamma = gamma
        self.explicit = gamma == 0.0
        self.before = model.instant(s.r, s.v, s.t, self.ends0)
        self.force0 = model.force(self.before)
        #: The end of the step at constant velocity.
        self.coasting = model.kinematics(s.r + h * s.v, s.v, s.t + h, self.ends1)
        self.prepared = model.prepare(self.coasting)

    def guess(self) -> Unknowns:
        return Unknowns(self.h * self.s.acceleration, self.s.tension)

    def _end_kinematics(self, x: Array) -> Kinematics:
        s = self.s
        r1 = s.r + self.h * (s.v + self.gamma * x)
        return self.model.kinematics(r1, s.v + x, s.t + self.h, self.ends1, prepared=self.prepared)

    def node_rows(self, x: Array, z: PerLaw) -> NodeRows:
        rows = self.mass[:, None] * x / self.h - (1 - self.gamma) * self.force0
        if not self.explicit:
            rows = rows - self.gamma * self.model.force(self._end_kinematics(x))
        return rows, ()

    def link_rows(self, d: Array, y: Array) -> tuple[Array, Array]:
        line = self.model.line
        gamma = self.gamma
        if self.explicit:
            speed = dot(self.unit_forces(self.coasting.links), self.coasting.link_velocities + d)
            return y[:, None] * self.pull0, self.h * speed
        links1 = self.coasting.links + gamma * self.h * d
        before = (1 - gamma) * self.s.tension[:, None] * self.pull0
        return gamma * y[:, None] * self.unit_forces(links1) + before, line.axial.at_rest(links1, y, line.length)

    def finish(self, u: Unknowns) -> State:
        after = self._end_kinematics(u.x)
        return self.end_state(
            r=after.r,
            v=after.v,
            tension=u.y,
            acceleration=jax.lax.stop_gradient(u.x / self.h),
            work=lambda: self._work(u, after),
        )

    def _work(self, u: Unknowns, after: Kinematics) -> Array:
        """Weighted power of both ends (k,) [J]; first order like the scheme."""
        gamma = self.gamma
        mean = gamma * after.v + (1 - gamma) * self.before.v
        return book_works(
            self.model,
            self.force_works(after, mean, gamma),
            self.force_works(self.before, mean, 1 - gamma),
            self.end_works(u.y[:, None] * self.unit_forces(after.links), self.ends1, k=after),
        )
