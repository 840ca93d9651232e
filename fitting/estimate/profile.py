"""Profile likelihood: growth of the best cost when one parameter is fixed away from its optimum."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from fitting.estimate.gauss_newton import descend
from fitting.estimate.normal_equations import solve_spd
from fitting.estimate.problem import Solution
from fitting.estimate.shooting import level_of
from fitting.estimate.uncertainty import degrees_of_freedom

#: Maximum evaluations at each value.
EVALUATIONS = 15


@dataclass(frozen=True)
class Profile:
    """Half the growth of chi-square, in units of the noise, at values (g,) of one parameter; ends of its interval.

    Attributes:
        converged: whether all other parameters were at their optimum at every value.
    """

    name: str
    values: np.ndarray
    growth: np.ndarray
    low: float
    high: float
    converged: bool = True


def profile(
    solution: Solution,
    name: str,
    std_error: float,
    *,
    level: float = 0.90,
    reach: float = 3.0,
    points: int = 3,
) -> Profile:
    """Refit all other parameters with one fixed at `points` values on either side, up to `reach` standard errors.

    The interval is where twice the growth stays below the `level` quantile of chi-square with one degree of freedom
    (Wilks 1938), read from a quadratic through the nearest points. If the standard error exceeds that from the noise
    (correlated residuals, a partly wrong model), the growth is scaled down accordingly (Kent 1982).

    Args:
        std_error: of the parameter, from `uncertainty`.
    """
    index = [p.name for p in solution.problem.parameters].index(name)
    p = solution.problem.parameters[index]
    held = solution.problem.held_mask.copy()
    held[index] = True
    level_there = level_of(replace(solution.problem, frozen=held), solution.gap_weight)
    unit, best = _unit(solution, index, std_error), float(solution.values[index])
    cost = level_of(solution.problem, solution.gap_weight).cost(solution.evaluation, solution.values)
    found, converged = {best: 0.0}, True
    for side in (-1, 1):
        point = solution
        for j in range(1, points + 1):
            value = float(np.clip(best + side * reach * std_error * j / points, p.low, p.high))
            if value in found:
                break
            values = point.values.copy()
            values[index] = value
            along = point.eliminated[..., index] * (value - point.values[index])
            starts = point.problem.move_starts(point.starts, point.values, along)
            evaluation = level_there.problem.evaluate(values, starts)
            begin = replace(point, values=values, starts=evaluation.starts, evaluation=evaluation, history=[])
            point = descend(level_there, begin, EVALUATIONS)
            converged &= point.status == "ok"
            found[value] = (point.cost - cost) / unit
    at = np.array(sorted(found))
    growth = np.array([found[x] for x in at])
    limit = 0.5 * float(chdtri(1, 1 - level))
    ends = (_crossing(at, growth, best, limit, side) for side in (-1, 1))
    return Profile(name, at, growth, *ends, converged)


def _unit(solution: Solution, index: int, std_error: float) -> float:
    """Growth of the cost [units of the assumed noise] that counts as one."""
    free = np.flatnonzero(~solution.problem.held_mask)
    inverse = solve_spd(solution.information[np.ix_(free, free)], np.eye(len(free)))
    own = float(inverse[np.flatnonzero(free == index)[0], np.flatnonzero(free == index)[0]])
    noise = solution.chi2 / degrees_of_freedom(solution)
    return max(noise, std_error**2 / max(own, 1e-300), 1e-300)


def _crossing(at: np.ndarray, growth: np.ndarray, best: float, limit: float, side: int) -> float:
    """Where the root of the growth, which is nearly linear, crosses the limit; the last point if it does not."""
    one = side * (at - best) >= 0
    distance, root = np.abs(at[one] - best), np.sqrt(np.maximum(growth[one], 0.0))
    order = np.argsort(distance)
    distance, root = distance[order], root[order]
    if root[-1] < np.sqrt(limit):
        return best + side * float(distance[-1])
    return best + side * float(np.interp(np.sqrt(limit), np.maximum.accumulate(root), distance))
