"""Explicit second-order Runge-Kutta (midpoint), as MoorDyn and the paper use it, for elastic lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax

from dropper_jax.integrators.runge_kutta import RungeKutta, combine, rates
from dropper_jax.model.model import Model
from dropper_jax.model.state import State


@dataclass(frozen=True)
class RK2(RungeKutta):
    """`y1 = y0 + h f(y0 + h/2 f(y0))`."""

    name: ClassVar[str] = "rk2"
    order: ClassVar[int] = 2

    def advance(self, model: Model, s: State, h: jax.Array) -> State:
        track = bool(s.work.size)
        (dr, dv, _), _ = rates(model, s.r, s.v, s.t, track)
        slope, _ = rates(model, s.r + h / 2 * dr, s.v + h / 2 * dv, s.t + h / 2, track)
        return combine(model, s, h, slope)
