"""The thesis' weighting: forces and tensions of both ends of the step, weighted by gamma.

    M (v1 - v0)/h = gamma (F1 + G1' T1) + (1 - gamma) (F0 + G0' T0),    r1 = r0 + h (gamma v1 + (1 - gamma) v0)

with the constraint at r1. Gamma = 1 is implicit Euler, 0.51 the thesis (5.4). For gamma = 0, explicit Euler, r1 does
not depend on T1. The tension of the old time is then the one that makes the new velocity consistent with the constraint
at r1 (half-explicit Euler; Hairer and Wanner), and link lengths drift.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from dropper_jax.base.fields import parameter
from dropper_jax.model import Kinematics, Model, State, book_works
from dropper_jax.residual import CondensedParts, Implicit, SpeedProblem, Unknowns, node_blocks, point_masses_only


@dataclass(frozen=True)
class Theta(Implicit):
    """End-point weighted scheme, first order (gamma = 0.5 is formally second and unstable in the tensions)."""

    name: ClassVar[str] = "theta"
    order: ClassVar[int] = 1
    condensable: ClassVar[bool] = True
    gamma: float = parameter(
        "weight of the new time, 0 for explicit, 1 for implicit Euler", unit="-", low=0.0, high=1.0, default=0.51
    )

    @property
    def holds_length(self) -> bool:
        return not _is_explicit(self.gamma)

    @property
    def dissipates(self) -> bool:
        return self.gamma > 0.5

    def common_form(self, model: Model) -> tuple[Implicit, float | None]:
        return (Theta(), self.gamma) if self.holds_length else (self, None)

    def refuse(self, model: Model) -> str | None:
        return point_masses_only(model) or super().refuse(model)

    def equations(self, model: Model, s: State, h: jax.Array) -> ThetaProblem:
        return ThetaProblem(model, s, h, self.gamma if s.weight is None else s.weight)


def _is_explicit(gamma: float | jax.Array) -> bool:
    return isinstance(gamma, float) and gamma == 0.0


class ThetaProblem(SpeedProblem):
    """Unknowns: x = v1 - v0 and the tensions T1 (gamma = 0: T0)."""

    def __init__(self, model: Model, s: State, h: jax.Array, gamma: float | jax.Array) -> None:
        super().__init__(model, s, h)
        self.gamma, self.explicit = gamma, _is_explicit(gamma)
        self.before = model.instant(s.r, s.v, s.t, self.ends0)
        self.force0 = model.force(self.before)
        self.prepared = model.prepare(model.kinematics(s.r + h * s.v, s.v, s.t + h, self.ends1))

    def guess(self) -> Unknowns:
        return Unknowns(self.h * self.s.acceleration, self.s.tension)

    def _end_kinematics(self, x: jax.Array) -> Kinematics:
        s, h = self.s, self.h
        r1 = s.r + h * (s.v + self.gamma * x)
        return self.model.kinematics(r1, s.v + x, s.t + h, self.ends1, prepared=self.prepared)

    def _local(self, x: jax.Array) -> jax.Array:
        old = self.mass[:, None] * x / self.h - (1 - self.gamma) * self.force0
        return old if self.explicit else old - self.gamma * self.model.force(self._end_kinematics(x))

    def residual(self, u: Unknowns) -> Unknowns:
        model, line, gamma = self.model, self.model.line, self.gamma
        after = self._end_kinematics(u.x)
        force = self._local(u.x)
        if self.explicit:
            speed = jnp.sum(self.unit_forces(after.links) * model.rates(after.v, self.ends1), axis=-1)
            return Unknowns(force - model.tension_force(u.y, self.pull0), self.h * speed)
        force = force - gamma * model.tension_force(u.y, self.unit_forces(after.links))
        force = force - (1 - gamma) * model.tension_force(self.s.tension, self.pull0)
        return Unknowns(force, line.axial.at_rest(after.links, u.y, line.length))

    def node_matrix(self, u: Unknowns) -> jax.Array:
        line, gamma, h = self.model.line, self.gamma, self.h
        node = node_blocks(lambda x: self._local(u.x + x), self.model.free_nodes, u.x.dtype)
        stiffness = u.y / line.length
        geometric = 0.5 * gamma**2 * h * jnp.maximum(line.at_nodes(stiffness, stiffness), 0.0)
        return node + geometric[:, None, None] * jnp.eye(3, dtype=u.x.dtype)

    def condensed_parts(self, u: Unknowns) -> CondensedParts:
        gamma, pull1, none = self.gamma, self.unit_forces(self._end_kinematics(u.x).links), jnp.zeros_like(u.y)
        if self.explicit:
            return CondensedParts(self.pull0, self.h * pull1, none)
        return CondensedParts(gamma * pull1, gamma * self.h * pull1, none)

    def finish(self, u: Unknowns, evaluated: Any = None) -> State:
        after = self._end_kinematics(u.x)
        return self.end_state(
            r=after.r,
            v=after.v,
            tension=u.y,
            acceleration=jax.lax.stop_gradient(u.x / self.h),
            work=lambda: self._work(u, after),
        )

    def _work(self, u: Unknowns, after: Kinematics) -> jax.Array:
        """Weighted power of both ends (k,) [J]; first order like the scheme."""
        model, gamma, h, before = self.model, self.gamma, self.h, self.before
        mean = gamma * after.v + (1 - gamma) * before.v
        then, now = model.working_forces(before), model.working_forces(after)
        works = {name: h * jnp.sum((gamma * now[name] + (1 - gamma) * then[name]) * mean) for name in now}
        ends = model.end_powers(u.y[:, None] * self.unit_forces(after.links), self.ends1, after)
        return book_works(model, works, {name: h * power for name, power in ends.items()})
