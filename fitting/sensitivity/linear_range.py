"""The size of changes that exact derivatives predict, by runs along them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dropper_jax.study.gradient_check import GradientCheck
from fitting.sensitivity.problem import Study


class LinearRange(NamedTuple):
    """What a run with all parameters changed shows of exact derivatives.

    Attributes:
        size: relative change of all parameters that they predict: 0.01, 0.001, 0.0001, otherwise 0.
        error: of the derivatives as predictions of that change (p,): what all together do not predict.
        warnings: one unless the change is 0.01.
        along: that run and the one with the opposite change; None where a bound is between.
    """

    size: float
    error: np.ndarray
    warnings: list[str]
    along: GradientCheck | None


def linear_range(
    problem: Study, value: float, slopes: np.ndarray, evaluate: Callable[[np.ndarray], float]
) -> LinearRange:
    """Relative change of all parameters that the derivatives `slopes` (p,) predict.

    A prediction holds within a third of the change, or within 0.01 in `p/Q dQ/dp`. All parameters change together, each
    in the direction that increases the quantity, so that one run at 1 % is enough for a smooth motion. One with the
    opposite change checks the derivatives along this direction.
    """
    scale = np.array([p.scale for p in problem.parameters])
    step = np.where(slopes < 0.0, -1.0, 1.0) * scale
    ahead = problem.values + 0.01 * step
    inside = [p.low <= x <= p.high for p, x in zip(problem.parameters, ahead, strict=True)]
    step = np.where(inside, step, -step)
    behind = problem.values - 0.01 * step
    along = None
    changes = []
    for size in (1e-2, 1e-3, 1e-4):
        real = evaluate(problem.values + size * step) - value
        changes.append((real, size * float(slopes @ step)))
        if size == 1e-2 and all(p.low <= x <= p.high for p, x in zip(problem.parameters, behind, strict=True)):
            opposite = evaluate(behind) - value
            along = GradientCheck.of(2.0 * changes[0][1], real - opposite, 2e-4 * abs(value))
        missed = abs(real - changes[-1][1])
        # not less: `max` jumps by 0.3 % where another sample becomes the largest, 22 % of a change by 1 % (lab dropper)
        if missed <= max(abs(changes[-1][1]) / 3.0, 0.01 * size * abs(value)):
            break
    else:
        size = 0.0
    error = np.where(slopes == 0.0, 0.0, missed / ((size or 1e-4) * scale))
    if len(changes) == 1:
        return LinearRange(size, error, [], along)
    real, predicted = changes[0]
    unit = problem.of.unit
    if np.isfinite(real):
        effect = f"changes by {real:.3g} {unit}"
    else:
        effect = "has a failed step"
    warning = (
        f"{problem.of.name}: {effect} if all parameters change by 1 %; the derivatives predict {predicted:.3g} "
        f"{unit}. They are valid for changes below {100 * size or 0.01:.2g} % only. Use a sweep for larger ones"
    )
    return LinearRange(size, error, [warning], along)
