"""Explicit fourth-order Runge-Kutta, for elastic lines."""

from __future__ import annotations

from dataclasses import dataclass

from dropper_jax.integrators.runge_kutta import RungeKutta


@dataclass(frozen=True)
class RK4(RungeKutta):
    """The classical four-stage scheme."""

    name = "rk4"
    order = 4
    a = ((0.5,), (0.0, 0.5), (0.0, 0.0, 1.0))
    b = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
