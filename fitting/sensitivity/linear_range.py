"""The size of changes that exact derivatives predict, by runs along them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dropper_jax.study.gradient_check import GradientCheck
from fitting.sensitivity.problem import Study
from fitting.sensitivity.result import LocalDerivatives

#: Relative changes of all parameters that are tried, the largest first.
CHANGE_SIZES = (1e-2, 1e-3, 1e-4)


def with_linear_range(
    problem: Study, found: LocalDerivatives, evaluate: Callable[[np.ndarray], float]
) -> LocalDerivatives:
    """The result with the relative change of all parameters that its derivatives predict: 0.01, 0.001, 0.0001,
    otherwise 0; with their error as predictions of that change, which is what all together do not predict.

    A prediction holds within a third of the change, or within 0.01 in `p/Q dQ/dp`. All parameters change together, each
    in the direction that increases the quantity, so that one run at 1 % is enough for a smooth motion. One with the
    opposite change checks the derivatives along this direction, unless a bound is between.
    """
    value = found.value
    slopes = found.forward
    scale = np.array([p.scale for p in problem.parameters])
    low, high = np.array([(p.low, p.high) for p in problem.parameters]).T
    step = np.where(slopes < 0.0, -1.0, 1.0) * scale
    ahead = problem.values + CHANGE_SIZES[0] * step
    step = np.where((low <= ahead) & (ahead <= high), step, -step)
    behind = problem.values - CHANGE_SIZES[0] * step
    along = None
    changes = []
    holds = False
    for size in CHANGE_SIZES:
        real = evaluate(problem.values + size * step) - value
        predicted = size * float(slopes @ step)
        changes.append((real, predicted))
        if size == CHANGE_SIZES[0] and np.all((low <= behind) & (behind <= high)):
            opposite = evaluate(behind) - value
            along = GradientCheck.of(2.0 * predicted, real - opposite, 2e-4 * abs(value))
        missed = abs(real - predicted)
        # not less: `max` jumps by 0.3 % where another sample becomes the largest, 22 % of a change by 1 % (lab dropper)
        holds = missed <= max(abs(predicted) / 3.0, 0.01 * size * abs(value))
        if holds:
            break
    error = np.where(slopes == 0.0, 0.0, missed / (size * scale))
    warnings = []
    if len(changes) > 1:
        real, predicted = changes[0]
        unit = problem.of.unit
        effect = f"changes by {real:.3g} {unit}" if np.isfinite(real) else "has a failed step"
        warnings.append(
            f"{problem.of.name}: {effect} if all parameters change by 1 %; the derivatives predict {predicted:.3g} "
            f"{unit}. They are valid for changes below {100 * size:.2g} % only. Use a sweep for larger ones"
        )
    linear_range = size if holds else 0.0
    return replace(found, linear_range=linear_range, error=error, warnings=warnings, along=along)
