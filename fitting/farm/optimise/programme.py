"""The linear programme of a step of a design.

min  c.d + P sum s    over  low <= d <= high, g + J d <= limit + s, s >= 0
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fitting.farm.optimise.values import Values

#: Penalty of a violation, in objectives at the start.
PENALTY_AT_START = 10.0


@dataclass(frozen=True)
class Programme:
    """Solution of a linear programme: step (p,), predicted objective and violation."""

    step: np.ndarray
    objective: float
    violation: float


def solve_programme(values: Values, low: np.ndarray, high: np.ndarray, scale: float, limit: float) -> Programme:
    """The linear programme for steps between low and high (p,).

    Raises:
        RuntimeError: it has no solution, which the slack variables rule out.
    """
    from scipy.optimize import linprog  # noqa: PLC0415

    p = len(low)
    m = len(values.value)
    cost = np.concatenate([values.slope[:p] / scale, np.full(m, PENALTY_AT_START)])
    rows = np.hstack([values.slopes[:, :p], -np.eye(m)])
    bounds = [*zip(low, high, strict=True), *[(0.0, None)] * m]
    found = linprog(cost, A_ub=rows, b_ub=limit - values.value, bounds=bounds, method="highs")
    if found.status != 0:
        raise RuntimeError(found.message)
    step = found.x[:p]
    left = np.maximum(values.value + values.slopes[:, :p] @ step - limit, 0.0)
    return Programme(step, values.objective + values.slope[:p] @ step, left.sum())


def total_violation(values: Values, limit: float) -> float:
    """Total violation of the constraints."""
    return np.sum(np.maximum(values.value - limit, 0.0))
