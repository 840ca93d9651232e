"""Explicit Runge-Kutta schemes for lines that stretch: each is a tableau."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import ClassVar

import jax

from dropper_jax.integrators.rates import combine, rates
from dropper_jax.model import Model, State
from dropper_jax.residual import Explicit


@dataclass(frozen=True)
class RungeKutta(Explicit):
    """`k_i = f(t + c_i h, y + h sum_j a_ij k_j)`, `y1 = y + h sum_i b_i k_i`, with `c_i = sum_j a_ij`.

    Stable only for steps well below the axial period of the stiffest link.
    """

    #: Rows of the tableau below the first stage, each (1, i), and the weights (s,).
    a: ClassVar[tuple[tuple[float, ...], ...]]
    b: ClassVar[tuple[float, ...]]

    def advance(self, model: Model, s: State, h: jax.Array) -> State:
        track = bool(s.work.size)
        slopes = [rates(model, s.r, s.v, s.t, track)[0]]
        for row in self.a:
            dr, dv, _ = _weigh_slopes(row, slopes)
            slopes.append(rates(model, s.r + h * dr, s.v + h * dv, s.t + sum(row) * h, track)[0])
        return combine(model, s, h, _weigh_slopes(self.b, slopes))


def _weigh_slopes(weights: tuple[float, ...], slopes: list[tuple[jax.Array, ...]]) -> tuple[jax.Array, ...]:
    """The weighted sum of slopes; zero weights are skipped."""
    used = [(weight, slope) for weight, slope in zip(weights, slopes, strict=True) if weight]
    kept = [weight for weight, _ in used]
    return jax.tree.map(lambda *k: sum(map(operator.mul, kept, k)), *(slope for _, slope in used))
