"""Common result of every fit: estimates with errors and intervals, as rows and as plain values; profile likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import Any, Generic, NamedTuple

import numpy as np
from scipy.special import chdtri

from dropper_jax.base.errors import Progress, SceneError, nearest, silent
from dropper_jax.base.toml_text import SCHEMA
from dropper_jax.load.scene import Scene
from fitting.estimate.blocks import block_of, pieces, resample
from fitting.estimate.factors import invert_spd
from fitting.estimate.least_squares import descend, level_of
from fitting.estimate.residuals import E, P, Solution
from fitting.estimate.step_size import LARGEST_BIAS
from fitting.estimate.uncertainty import FEW, Uncertainty, degrees_of_freedom
from fitting.parameters.names import full_names
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


#: Maximum evaluations at each value.
PROFILE_ITERATIONS = 15


def profile(
    result: SceneFit,
    name: str,
    *,
    level: float = 0.90,
    reach: float = 3.0,
    points: int = 3,
) -> Profile:
    """Refit all other parameters with one fixed at `points` values on either side, up to `reach` standard errors.

    The interval is where twice the growth stays below the `level` quantile of chi-square with one degree of freedom
    (Wilks 1938), read from a quadratic through the nearest points. If the standard error exceeds that from the noise
    (correlated residuals, a partly wrong model), the growth is scaled down accordingly (Kent 1982).
    """
    solution = result.solution
    index = solution.problem.names.index(name)
    std_error = float(result.uncertainty.std_error[index])
    p = solution.problem.parameters[index]
    held = solution.problem.held_mask.copy()
    held[index] = True
    level_there = level_of(replace(solution.problem, frozen=held), solution.gap_weight)
    unit = _unit(solution, index, std_error)
    best = float(solution.values[index])
    cost = level_of(solution.problem, solution.gap_weight).cost(solution.evaluation, solution.values)
    found = {best: 0.0}
    converged = True
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
            point = descend(level_there, begin, PROFILE_ITERATIONS)
            converged &= point.status == "ok"
            found[value] = (point.cost - cost) / unit
    at, growth = np.array(sorted(found.items())).T
    limit = 0.5 * float(chdtri(1, 1 - level))
    low = _crossing(at, growth, best, limit, -1)
    high = _crossing(at, growth, best, limit, 1)
    return Profile(name, at, growth, low, high, converged)


def _unit(solution: Solution, index: int, std_error: float) -> float:
    """Growth of the cost [units of the assumed noise] that counts as one."""
    own = np.diag(invert_spd(solution.free_information))[solution.free == index]
    noise = solution.chi2 / degrees_of_freedom(solution)
    return max(noise, std_error**2 / max(float(own[0]), 1e-300), 1e-300)


def _crossing(at: np.ndarray, growth: np.ndarray, best: float, limit: float, side: int) -> float:
    """Where the root of the growth, which is nearly linear, crosses the limit; the last point if it does not."""
    one = np.flatnonzero(side * (at - best) >= 0)[::side]  # outwards from the best
    distance = np.abs(at[one] - best)
    root = np.sqrt(np.maximum(growth[one], 0.0))
    if root[-1] < np.sqrt(limit):
        return best + side * float(distance[-1])
    return best + side * float(np.interp(np.sqrt(limit), np.maximum.accumulate(root), distance))


def common_warnings(solution: Solution, u: Uncertainty) -> list[str]:
    """One line each of any fit: active bounds, few blocks of time behind the errors, shifts by the time step."""
    values = solution.by_name
    found = [f"{name} is at its bound {values[name]:g}" for name in compress(values, u.at_bound)]
    if 0 < u.blocks < FEW:
        found.append(
            f"standard errors come from the scatter of {u.blocks} blocks of time, fewer than {FEW}. Use longer "
            "traces for more reliable errors"
        )
    if solution.step_bias is not None:
        for name, bias in zip(values, solution.step_bias, strict=True):
            if abs(bias) > LARGEST_BIAS:
                found.append(f"the time step shifts {name} by {bias:+.2g} standard errors. Use a smaller dt")
    return found


@dataclass(kw_only=True)
class SceneFit(Generic[P, E]):
    """A scene fitted to measurements.

    Attributes:
        scene: the original scene.
        solution: end of the fit.
        uncertainty: errors of the estimates.
        warnings: one line each.
        seconds: wall time, or that of its parts.
        profiles: requested profile likelihoods.
        bootstrap: parameters (draws, k) of resampled blocks of time, if requested.
    """

    scene: Scene
    solution: Solution[P, E]
    uncertainty: Uncertainty
    warnings: list[str] = field(default_factory=list)
    seconds: float | dict[str, float] = 0.0
    profiles: list[Profile] = field(default_factory=list)
    bootstrap: np.ndarray | None = None

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
        if self.message:
            return f"{self.status}: {self.message}"
        return self.status

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
        return float(self.values[self.solution.problem.names.index(name)])

    def note(self, i: int) -> str:
        """Remark on a parameter, by its number."""
        if self.uncertainty.at_bound[i]:
            return "at bound"
        return ""

    @property
    def has_errors(self) -> bool:
        """Whether the estimates have errors: those of a fit that failed mean nothing."""
        return self.status == "ok"

    def estimates(self) -> dict[str, dict[str, Any]]:
        """Value, error, 90 % interval and unit of every parameter, by its path; no error (NaN) of a failed fit."""
        u = self.uncertainty
        errors = np.array([u.std_error, u.low, u.high])
        if not self.has_errors:
            errors[:] = np.nan
        found = {}
        for p, value, (std_error, low, high), at_bound in zip(
            self.parameters, self.values, errors.T, u.at_bound, strict=True
        ):
            found[p.name] = {
                "value": value,
                "std_error": std_error,
                "low": low,
                "high": high,
                "at_bound": bool(at_bound),
                "unit": p.unit,
            }
        return found

    def common_json(self, method: str, step: float) -> dict[str, Any]:
        """The values that every fit reports, with the keys of the command line's JSON; `step` [s] is the time step."""
        found = {
            "schema": SCHEMA,
            "status": self.status,
            "method": method,
            "parameters": self.estimates(),
            "correlation": self.uncertainty.correlation,
            "iterations": self.iterations,
            "seconds": self.seconds,
            "step_s": step,
            "step_bias_std_errors": self.step_bias,
            "blocks": self.uncertainty.blocks,
            "warnings": self.warnings,
            **self.intervals(),
        }
        if self.status != "ok":
            found["error"] = self.outcome
        return found

    def intervals(self) -> dict[str, Any]:
        """Profiles and bootstrap as plain values, if requested."""
        keys = ("low", "high", "values", "growth", "converged")
        profile = {}
        for p in self.profiles:
            profile[p.name] = {key: getattr(p, key) for key in keys}
        found = {"profile": profile, "bootstrap": self.bootstrap_table()}
        return {name: table for name, table in found.items() if table}

    def bootstrap_table(self) -> dict[str, dict[str, float]]:
        """Standard deviation and 90 % quantiles of the resampled parameters; empty without a bootstrap."""
        if self.bootstrap is None:
            return {}
        rows = np.array([self.bootstrap.std(axis=0, ddof=1), *np.quantile(self.bootstrap, [0.05, 0.95], axis=0)]).T
        keys = ("std_error", "low", "high")
        return {p.name: dict(zip(keys, row, strict=True)) for p, row in zip(self.parameters, rows, strict=True)}


def profiles(result: SceneFit, names: Sequence[str] = (), progress: Progress = silent) -> list[Profile]:
    """Profile likelihoods of free parameters, by their names or those of their fields; of all by default.

    Raises:
        SceneError: a parameter that is not free.
    """
    known = result.solution.problem.names
    found = []
    for name in names or known:
        if name in known:
            full = name
        else:
            full = full_names(result.scene, [name], "profile")[0]
        mine = [p for p in known if p == full or p.startswith((f"{full}.", f"{full}@"))]
        if not mine:
            raise SceneError(f"profile: {full!r} is not a free parameter; {nearest(full, known)}")
        found += mine
    rows = []
    for name in dict.fromkeys(found):
        progress(0.96, f"profile of {name}")
        rows.append(profile(result, name))
    return rows


class Bootstrap(NamedTuple):
    """Parameters (draws, k) of a bootstrap, and its effective number of blocks of time."""

    draws: np.ndarray
    blocks: float

    @property
    def warning(self) -> str:
        """One line if blocks are few, otherwise empty."""
        if self.blocks >= FEW:
            return ""
        return (
            f"the bootstrap draws from the equivalent of {self.blocks:.1f} blocks of time, fewer than {FEW}: the width "
            f"of its intervals is uncertain by {100 / np.sqrt(2 * max(self.blocks - 1, 1)):.0f} %. Use longer traces"
        )


def bootstrap(result: SceneFit, draws: int = 200, block: int | None = None, seed: int = 0) -> Bootstrap:
    """Parameters refitted, to first order, to blocks of time drawn with replacement (`uncertainty.resample`).

    The information of a draw is that of all stretches, because a draw of few may leave a parameter undetermined (Kline
    and Santos 2012).

    Args:
        block: number of stretches drawn together: windows, or parts of few ones; default two correlation times.

    Raises:
        SceneError: fewer than two draws.
    """
    check_draws(draws)
    solution = result.solution
    free = solution.free
    parts = pieces(solution, free)
    information = solution.free_information
    block = block or block_of(parts, information)
    moved, blocks = resample(parts, information, block, draws, np.random.default_rng(seed))
    found = np.tile(solution.values, (draws, 1))
    found[:, free] -= moved
    return Bootstrap(np.clip(found, *solution.problem.bounds(solution.values)), blocks)


def check_draws(draws: int) -> None:
    """Reject a number of draws that has no spread."""
    if draws < 2:
        raise SceneError(f"bootstrap: {draws} draws are too few; allowed: 0 or at least 2")
