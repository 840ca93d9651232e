"""Common result of every fit: estimates with errors and intervals, as rows and as plain values; profile likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import chdtri

from dropper_jax.base.errors import Progress, SceneError, nearest
from dropper_jax.load.scene import Scene
from fitting.estimate.gauss_newton import descend
from fitting.estimate.normal_equations import solve_spd
from fitting.estimate.nuts import nuts
from fitting.estimate.posterior import Posterior, importance
from fitting.estimate.problem import Solution
from fitting.estimate.shooting import level_of
from fitting.estimate.uncertainty import Uncertainty, bootstrap, degrees_of_freedom
from fitting.parameters.of_scene import full_names
from fitting.parameters.parameter import Parameter


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
            # maximum evaluations at each value
            point = descend(level_there, begin, 15)
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


SAMPLERS = {"importance": importance, "nuts": nuts}


@dataclass(kw_only=True)
class SceneFit:
    """A scene fitted to measurements.

    Attributes:
        scene: the original scene.
        solution: end of the fit.
        uncertainty: errors of the estimates.
        warnings: one line each.
        profiles: requested profile likelihoods.
        bootstrap: parameters (draws, k) of resampled blocks of time, if requested.
        posterior: weighted draws of the parameters, if requested.
    """

    scene: Scene
    solution: Solution
    uncertainty: Uncertainty
    warnings: list[str] = field(default_factory=list)
    profiles: list[Profile] = field(default_factory=list)
    bootstrap: np.ndarray | None = None
    posterior: Posterior | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What was free."""
        return self.solution.problem.parameters

    @property
    def values(self) -> np.ndarray:
        """The estimates (k,)."""
        return self.solution.values

    @property
    def status(self) -> str:
        """`ok` or `not_converged`; `message` gives the reason."""
        return self.solution.status

    @property
    def message(self) -> str:
        """The reason of a status that is not `ok`."""
        return self.solution.message

    @property
    def outcome(self) -> str:
        """Status and message in one line."""
        return f"{self.status}: {self.message}" if self.message else self.status

    @property
    def iterations(self) -> int:
        """Evaluations made."""
        return self.solution.iterations

    @property
    def step_bias(self) -> np.ndarray | None:
        """Shift of the estimates by the time step (k,) [standard errors]; None if it was not computed."""
        return self.solution.step_bias

    def __getitem__(self, name: str) -> float:
        """The estimate of a parameter by its path."""
        return float(self.values[[p.name for p in self.parameters].index(name)])

    def note(self, i: int) -> str:
        """Remark on a parameter, by its number."""
        return "at bound" if self.uncertainty.at_bound[i] else ""

    def estimates(self) -> dict[str, dict[str, Any]]:
        """Value, error, 90 % interval and unit of every parameter, by its path."""
        u = self.uncertainty
        rows = zip(self.parameters, self.values, u.std_error, u.low, u.high, u.at_bound, strict=True)
        return {
            p.name: {"value": v, "std_error": s, "low": a, "high": b, "at_bound": bool(c), "unit": p.unit}
            for p, v, s, a, b, c in rows
        }

    def intervals(self) -> dict[str, Any]:
        """Profiles, bootstrap and posterior as plain values, if requested."""
        found: dict[str, Any] = {}
        if self.profiles:
            found["profile"] = {
                p.name: {"low": p.low, "high": p.high, "values": p.values, "growth": p.growth, "converged": p.converged}
                for p in self.profiles
            }
        if self.bootstrap is not None:
            found["bootstrap"] = self.bootstrap_table()
        if self.posterior is not None:
            found["posterior"] = self.posterior.to_json()
        return found

    def bootstrap_table(self) -> dict[str, dict[str, float]]:
        """Standard deviation and 90 % quantiles of the resampled parameters."""
        draws = self.bootstrap
        low, high = np.quantile(draws, [0.05, 0.95], axis=0)
        spread = draws.std(axis=0, ddof=1)
        return {
            p.name: {"std_error": s, "low": a, "high": b}
            for p, s, a, b in zip(self.parameters, spread, low, high, strict=True)
        }


@dataclass(frozen=True)
class Intervals:
    """Intervals to compute in addition to the errors of a fit.

    Attributes:
        profile: names of free parameters whose profile likelihood is requested; True for all.
        bootstrap: draws over blocks of time.
        posterior: draws of the parameters.
        sampler: of the posterior, one of `SAMPLERS`.

    Raises:
        SceneError: one draw of a bootstrap, an unknown sampler.
    """

    profile: Sequence[str] | bool = False
    bootstrap: int = 0
    posterior: int = 0
    sampler: str = "importance"

    def __post_init__(self) -> None:
        if self.bootstrap < 0 or self.bootstrap == 1:
            raise SceneError(f"bootstrap: {self.bootstrap} draws are too few; allowed: 0 or at least 2")
        if self.sampler not in SAMPLERS:
            raise SceneError(f"sampler: {self.sampler!r} is unknown; {nearest(self.sampler, SAMPLERS)}")

    def profile_names(self, scene: Scene, parameters: Sequence[Parameter]) -> list[str]:
        """Free parameters whose profile is requested, by their names or those of their fields.

        Raises:
            SceneError: one that is not free.
        """
        known = [p.name for p in parameters]
        if isinstance(self.profile, bool):
            return known if self.profile else []
        found = []
        for name in self.profile:
            full = name if name in known else full_names(scene, [name], "profile")[0]
            mine = [p for p in known if p == full or p.startswith((f"{full}.", f"{full}@"))]
            if not mine:
                raise SceneError(f"profile: {full!r} is not a free parameter; {nearest(full, known)}")
            found += mine
        return list(dict.fromkeys(found))

    def add_to(self, result: SceneFit, progress: Progress) -> None:
        """Add the intervals to a result, with their warnings."""
        solution = result.solution
        errors = dict(zip([p.name for p in result.parameters], result.uncertainty.std_error, strict=True))
        for name in self.profile_names(result.scene, result.parameters):
            progress(0.96, f"profile of {name}")
            result.profiles.append(profile(solution, name, float(errors[name])))
        if self.bootstrap:
            drawn = bootstrap(solution, self.bootstrap)
            result.bootstrap = drawn.draws
            result.warnings += [drawn.warning] if drawn.warning else []
        if self.posterior and solution.status == "ok":
            result.posterior = SAMPLERS[self.sampler](solution, self.posterior, progress=progress)
            result.warnings += result.posterior.warnings
