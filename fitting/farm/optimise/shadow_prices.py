"""Shadow prices of an optimum: the cost of its active constraints, and the distance of the design from an optimum.

At an optimum the slope of the objective is balanced by active constraints and by bounds:

    c + sum_j lambda_j J_j - mu_low + mu_high = 0,    all >= 0

found by non-negative least squares over the variables that may still move, in units of their ranges. A linear
programme within a reach also has prices, but those of its corner. With fewer active constraints than variables the
reach itself balances the rest, and the prices are arbitrary.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fitting.farm.optimise.values import Values, active_constraints

#: Fraction of a variable's range from a bound within which the bound counts as active.
AT_BOUND = 1e-3


class ShadowPrices(NamedTuple):
    """Shadow prices of a design.

    Attributes:
        by_constraint: decrease of the objective for a limit that is higher by 1 (m,), >= 0.
        unbalanced: fraction of the objective's slope that constraints and bounds do not balance: 0 at an optimum.
    """

    by_constraint: np.ndarray
    unbalanced: float


def shadow_prices(
    values: Values, x: np.ndarray, low: np.ndarray, high: np.ndarray, fixed: np.ndarray, limit: float
) -> ShadowPrices:
    """Shadow prices at a design.

    Args:
        low, high: bounds (p,); fixed: variables on a size of their catalogue (p,), which stay there.
        limit: upper limit of the constraints.
    """
    from scipy.optimize import nnls  # noqa: PLC0415

    p = len(x)
    span = high - low
    cost = (values.slope[:p] * span)[~fixed]
    active = active_constraints(values, limit)
    axes = np.eye(p)
    walls = np.hstack([-axes[:, x - low <= AT_BOUND * span], axes[:, high - x <= AT_BOUND * span]])
    by_constraint = np.zeros(len(values.value))
    size = np.linalg.norm(cost)
    if size == 0.0:
        return ShadowPrices(by_constraint, 0.0)
    matrix = np.hstack([(values.slopes[active, :p] * span).T, walls])[~fixed]
    if not matrix.shape[1]:
        return ShadowPrices(by_constraint, 1.0)
    found, left = nnls(matrix, -cost)
    by_constraint[active] = found[: len(active)]
    return ShadowPrices(by_constraint, left / size)
