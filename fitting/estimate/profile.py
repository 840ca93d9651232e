"""Profile likelihood: how the best cost grows as one parameter is held away from its optimum."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.problem import Solution


@dataclass(frozen=True)
class Profile:
    """Half the growth of chi-square, in units of the noise, at values (g,) of one parameter; ends of its interval."""

    name: str
    values: np.ndarray
    growth: np.ndarray
    low: float
    high: float


def profile(
    solution: Solution,
    name: str,
    std_error: float,
    *,
    level: float = 0.90,
    reach: float = 3.0,
    points: int = 3,
) -> Profile:
    """Refit everything else with one parameter held at `points` values on either side, up to `reach` standard errors.

    The interval is where twice the growth stays below the `level` quantile of chi-square with one degree of freedom
    (Wilks 1938), read from a quadratic through the points next to it.
    """
    index = [p.name for p in solution.problem.parameters].index(name)
    p = solution.problem.parameters[index]
    held = solution.problem.held.copy()
    held[index] = True
    problem = replace(solution.problem, frozen=held)
    unit = max(2 * solution.cost / max(solution.windows.samples, 1), 1e-300)
    best = float(solution.values[index])
    found = {best: 0.0}
    for side in (-1, 1):
        starts, values = solution.starts, solution.values.copy()
        for j in range(1, points + 1):
            place = float(np.clip(best + side * reach * std_error * j / points, p.low, p.high))
            if place in found:
                break
            values = values.copy()
            values[index] = place
            other = fit_windows(problem, values, starts, iterations=15)
            found[place] = (other.cost - solution.cost) / unit
            starts, values = other.starts, other.values
    at = np.array(sorted(found))
    growth = np.array([found[x] for x in at])
    limit = 0.5 * float(chi2.ppf(level, 1))
    return Profile(name, at, growth, _crossing(at, growth, best, limit, -1), _crossing(at, growth, best, limit, 1))


def _crossing(at: np.ndarray, growth: np.ndarray, best: float, limit: float, side: int) -> float:
    """Where the root of the growth, which is nearly straight, passes the limit; the last point if it does not."""
    one = side * (at - best) >= 0
    distance, root = np.abs(at[one] - best), np.sqrt(np.maximum(growth[one], 0.0))
    order = np.argsort(distance)
    distance, root = distance[order], root[order]
    if root[-1] < np.sqrt(limit):
        return best + side * float(distance[-1])
    return best + side * float(np.interp(np.sqrt(limit), np.maximum.accumulate(root), distance))
