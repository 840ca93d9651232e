"""Explicit fourth-order Runge-Kutta, for elastic lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax

from dropper_jax.integrators.runge_kutta import RungeKutta, combine, rates
from dropper_jax.model.model import Model
from dropper_jax.model.state import State


@dataclass(frozen=True)
class RK4(RungeKutta):
    """The classical four-stage scheme."""

    name: ClassVar[str] = "rk4"
    order: ClassVar[int] = 4

    def advance(self, model: Model, s: State, h: jax.Array) -> State:
        track = bool(s.work.size)

        def at(fraction: float, slope) -> tuple:  # noqa: ANN001
            part = fraction * h
            return rates(model, s.r + part * slope[0], s.v + part * slope[1], s.t + part, track)[0]

        k1 = rates(model, s.r, s.v, s.t, track)[0]
        k2 = at(0.5, k1)
        k3 = at(0.5, k2)
        k4 = at(1.0, k3)
        slope = jax.tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, k1, k2, k3, k4)
        return combine(model, s, h, slope)
