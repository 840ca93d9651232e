"""Profile likelihood of a parameter: growth of the cost, with all others refitted, and the interval that it gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.progress import Progress, silent
from fitting.estimate.factors import invert_spd
from fitting.estimate.least_squares import descend
from fitting.estimate.objective import Objective, objective_at
from fitting.estimate.scene_fit import Profile, SceneFit
from fitting.estimate.solution import Solution
from fitting.estimate.uncertainty import degrees_of_freedom
from fitting.parameters.names import full_names

#: Probability that the interval contains the true value: that of all other intervals of a fit.
PROFILE_LEVEL = 0.90
#: Distance of the outermost value from the estimate [standard errors]. The interval of a quadratic growth ends at 1.64:
#: one that grows up to 3.3 times slower is still bounded.
PROFILE_REACH = 3.0
#: Maximum evaluations at each value.
PROFILE_ITERATIONS = 15


def profile(result: SceneFit, name: str, *, points: int = 3) -> Profile:
    """Profile likelihood of a parameter: all others are refitted with it fixed at `points` values on either side.

    The values reach `PROFILE_REACH` standard errors from the estimate, within the parameter's bounds.
    The interval is where twice the growth stays below the `PROFILE_LEVEL` quantile of chi-square with one degree of
    freedom (Wilks 1938). It is interpolated in the root of the growth. If the standard error exceeds that from the
    noise (correlated residuals, a partly wrong model), the growth is scaled down accordingly (Kent 1982).

    Raises:
        SceneError: fewer than one point, a parameter that is not free, or the name of several.
    """
    if points < 1:
        raise SceneError(f"profile: {points} points on either side; allowed: at least 1")
    name, *others = free_names(result, name)
    if others:
        raise SceneError(f"profile: {name!r} is one of {1 + len(others)} parameters of this name. Use its full path")
    solution = result.solution
    index = solution.problem.names.index(name)
    std_error = result.uncertainty.std_error[index]
    p = solution.problem.parameters[index]
    frozen = solution.problem.held_mask.copy()
    frozen[index] = True
    fixed_objective = objective_at(replace(solution.problem, frozen=frozen), solution.gap_weight)
    unit = _unit(solution, index, std_error)
    best = solution.values[index]
    cost = objective_at(solution.problem, solution.gap_weight).cost(solution.evaluation, solution.values)
    found = {best: 0.0}
    converged = True
    for side in (-1, 1):
        point = solution
        for j in range(1, points + 1):
            value = np.clip(best + side * PROFILE_REACH * std_error * j / points, p.low, p.high)
            if value in found:
                break
            point = _refit(point, fixed_objective, index, value)
            converged &= point.status == "ok"
            found[value] = (point.cost - cost) / unit
    at, growth = np.array(sorted(found.items())).T
    limit = 0.5 * chdtri(1, 1 - PROFILE_LEVEL)
    low = _crossing(at, growth, best, limit, -1)
    high = _crossing(at, growth, best, limit, 1)
    return Profile(name, at, growth, low, high, converged)


def _refit(point: Solution, objective: Objective, index: int, value: float) -> Solution:
    """The fit from a point, with one parameter moved to a value and fixed there by the objective."""
    values = point.values.copy()
    values[index] = value
    along = point.eliminated[..., index] * (value - point.values[index])
    evaluation = objective.problem.evaluate(values, point.problem.move_starts(point.starts, point.values, along))
    begin = replace(point, values=values, starts=evaluation.starts, evaluation=evaluation, history=[])
    return descend(objective, begin, PROFILE_ITERATIONS)


def _unit(solution: Solution, index: int, std_error: float) -> float:
    """Growth of the cost [units of the assumed noise] that counts as one."""
    own = np.diag(invert_spd(solution.free_information))[solution.free == index]
    noise = solution.chi2 / degrees_of_freedom(solution)
    return max(noise, std_error**2 / max(own[0], 1e-300), 1e-300)


def _crossing(at: np.ndarray, growth: np.ndarray, best: float, limit: float, side: int) -> float:
    """Where the root of the growth, which is nearly linear, crosses the limit; the last point if it does not."""
    outwards = np.flatnonzero(side * (at - best) >= 0)[::side]
    distance = np.abs(at[outwards] - best)
    root = np.sqrt(np.maximum(growth[outwards], 0.0))
    if root[-1] < np.sqrt(limit):
        return best + side * distance[-1]
    return best + side * np.interp(np.sqrt(limit), np.maximum.accumulate(root), distance)


#: Fraction of the whole work that is done when the profiles start, for progress reports: the fit takes most of it.
PROFILES_FRACTION = 0.96


def profiles(result: SceneFit, names: Sequence[str], progress: Progress = silent) -> list[Profile]:
    """Profile likelihoods of free parameters, by their names or those of their fields; of all without names.

    Raises:
        SceneError: a parameter that is not free.
    """
    found = []
    for name in names or result.solution.problem.names:
        found += free_names(result, name)
    rows = []
    for name in dict.fromkeys(found):
        progress(PROFILES_FRACTION, f"profile of {name}")
        rows.append(profile(result, name))
    return rows


def free_names(result: SceneFit, name: str) -> list[str]:
    """The free parameters of a name, which may be short, or that of a field with several.

    Raises:
        SceneError: a parameter that is not free.
    """
    known = result.solution.problem.names
    if name not in known:
        name = full_names(result.scene, [name], "profile")[0]
    mine = [p for p in known if p == name or p.startswith((f"{name}.", f"{name}@"))]
    if not mine:
        raise SceneError(f"profile: {name!r} is not a free parameter; {nearest(name, known)}")
    return mine
