"""Explicit second-order Runge-Kutta (midpoint), as MoorDyn and the paper use it, for elastic lines."""

from __future__ import annotations

from dataclasses import dataclass

from dropper_jax.integrators.runge_kutta import RungeKutta


@dataclass(frozen=True)
class RK2(RungeKutta):
    """`y1 = y0 + h f(y0 + h/2 f(y0))`."""

    name = "rk2"
    order = 2
    a = ((0.5,),)
    b = (0.0, 1.0)
