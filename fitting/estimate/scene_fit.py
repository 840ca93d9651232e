"""Common result of every fit: estimates with errors and intervals, as rows and as plain values."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import compress
from typing import Any, Generic

import numpy as np

from dropper_jax.base.json_values import SCHEMA
from dropper_jax.load.scene import Scene
from fitting.estimate.solution import EvaluationType, ProblemType, Solution
from fitting.estimate.step_size import LARGEST_BIAS
from fitting.estimate.uncertainty import FEW_BLOCKS, Uncertainty, prior_conflicts
from fitting.parameters.parameter import Parameter

#: Standard deviations between a prior and the data from which it is warned of: chance reaches 4 once in 16 000.
CONFLICT = 4.0


def common_warnings(solution: Solution, u: Uncertainty) -> list[str]:
    """One line each of any fit: active bounds, few blocks of time behind the errors, shifts by the time step."""
    values = solution.by_name
    found = [f"{name} is at its bound {values[name]:g}" for name in compress(values, u.at_bound)]
    conflicts = prior_conflicts(solution, u)
    for i in np.flatnonzero(np.abs(conflicts) > CONFLICT):
        mean, sigma = solution.problem.parameters[i].prior
        found.append(
            f"{solution.problem.names[i]}: the data contradict its prior of {mean:.4g} +- {sigma:.2g} by "
            f"{abs(conflicts[i]):.2g} standard deviations. Check the prior, or give a wider one"
        )
    if 0 < u.blocks < FEW_BLOCKS:
        found.append(
            f"standard errors come from the scatter of {u.blocks} blocks of time, fewer than {FEW_BLOCKS}. Use longer "
            "traces for more reliable errors"
        )
    if solution.step_bias is not None:
        for name, bias in zip(values, solution.step_bias, strict=True):
            if abs(bias) > LARGEST_BIAS:
                found.append(f"the time step shifts {name} by {bias:+.2g} standard errors. Use a smaller dt")
    return found


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


@dataclass(kw_only=True)
class SceneFit(Generic[ProblemType, EvaluationType]):
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
    solution: Solution[ProblemType, EvaluationType]
    uncertainty: Uncertainty
    warnings: list[str] = field(default_factory=list)
    seconds: float | dict[str, float] = 0.0
    profiles: list[Profile] = field(default_factory=list)
    bootstrap: np.ndarray | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters."""
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
        for i, p in enumerate(self.parameters):
            std_error, low, high = errors[:, i]
            found[p.name] = {
                "value": self.values[i],
                "std_error": std_error,
                "low": low,
                "high": high,
                "at_bound": bool(u.at_bound[i]),
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
        profile_rows = {}
        for p in self.profiles:
            profile_rows[p.name] = {key: getattr(p, key) for key in keys}
        found = {"profile": profile_rows, "bootstrap": self.bootstrap_table()}
        return {name: table for name, table in found.items() if table}

    def bootstrap_table(self) -> dict[str, dict[str, float]]:
        """Standard deviation and 90 % quantiles of the resampled parameters; empty without a bootstrap."""
        if self.bootstrap is None:
            return {}
        rows = np.array([self.bootstrap.std(axis=0, ddof=1), *np.quantile(self.bootstrap, [0.05, 0.95], axis=0)]).T
        keys = ("std_error", "low", "high")
        return {p.name: dict(zip(keys, row, strict=True)) for p, row in zip(self.parameters, rows, strict=True)}
