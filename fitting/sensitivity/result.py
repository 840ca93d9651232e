"""Result of a local study: derivatives of a quantity, their errors and range of validity."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from dropper_jax.study.gradient_check import TRUSTED, GradientCheck
from fitting.sensitivity.problem import Study

#: Status of a slope: known to a third; not; differences reach another branch of the motion; no number at all.
KNOWN = "known"
UNCLEAR = "unclear"
OTHER_BRANCH = "other_branch"
NOT_RESOLVED = "not_resolved"
#: Slope or error of a slope that is not known, as `p/Q dQ/dp`, from which it is not resolved: the change would be as
#: large as the quantity for 1 % of the parameter.
UNRESOLVED_SLOPE = 100.0
#: Growth of a difference of two runs by 0.3 %, as a power of e, from which the motion itself is chaotic: it
#: then displaces a node by a sixth of the motion.
MOTION_GROWTH = 4.0
#: The same of rigid lines, by 1 % of all parameters.
MOTION_GROWTH_RIGID = 2.8
#: Growth of the small difference, as a power of e, from which rounding errors and exact tangents grow.
TANGENT_GROWTH = 5.0
TANGENT = "tangent"
OF_RUNS = "differences"


@dataclass(frozen=True)
class LocalDerivatives:
    """Derivatives at the scene's values.

    Attributes:
        names, units, values: of the parameters.
        of, unit, value: the quantity.
        forward: dQ/dp (p,).
        method: `tangent` (exact derivatives) or `differences` (of runs with links that stretch).
        error: of `forward` (p,); None if it is not known.
        growth: logarithm of the growth of small changes over the run, those of the tangent; None without a run.
        motion_growth: the same of changes by 0.3 % (1 % of rigid lines): above `MOTION_GROWTH` (`MOTION_GROWTH_RIGID`)
            the motion is chaotic; None if not known.
        value_error, noise: error of the quantity by the steps of its run, and what rounding makes of it; NaN if not
            known.
        slope_status: of each parameter, `known`, `unclear` (not known to a third), `other_branch` (a run or start
            within 1 % is on another branch), or `not_resolved`, whose slope is NaN.
        along: of exact derivatives, two runs along them: all parameters change by 1 %, each in the direction that
            increases the quantity, and by the opposite. None where a bound prevents it.
        horizon: time [s] up to which derivatives are valid; `duration` [s] of the run.
        reverse: dQ/dp by reverse mode (p,); None unless requested.
        exponent: growth rate [1/s] of the derivatives where they are not valid for the whole run, or of small errors,
            the Lyapunov exponent, if that was requested; otherwise None.
        window: length [s] of the windows of the means; None if derivatives are valid for the whole run.
        window_mean, window_error: mean derivative of the windows' values and its standard error (p,).
        linear_range, warnings: relative change of all parameters that the derivatives predict, at most 0.01, and a
            warning if it is less (see `linear_range`).
    """

    names: list[str]
    units: list[str]
    values: np.ndarray
    of: str
    unit: str
    value: float
    forward: np.ndarray
    horizon: float
    duration: float
    reverse: np.ndarray | None = None
    exponent: float | None = None
    window: float | None = None
    window_mean: np.ndarray | None = None
    window_error: np.ndarray | None = None
    linear_range: float = 0.01
    warnings: list[str] = field(default_factory=list)
    method: str = TANGENT
    error: np.ndarray | None = None
    growth: float | None = None
    motion_growth: float | None = None
    value_error: float = np.nan
    noise: float = np.nan
    slope_status: tuple[str, ...] = ()
    along: GradientCheck | None = None

    @property
    def unclear(self) -> tuple[str, ...]:
        """Names of parameters whose slope is not known."""
        pairs = zip(self.names, self.slope_status, strict=True)
        return tuple(name for name, status in pairs if status != KNOWN)

    @property
    def resolved(self) -> np.ndarray:
        """Whether each slope is a number (p,)."""
        return np.array([status != NOT_RESOLVED for status in self.slope_status], bool)

    @property
    def scaled(self) -> np.ndarray:
        """`p/Q dQ/dp` (p,): percentage change of the quantity for 1 % change of the parameter; NaN if Q is 0."""
        if self.value:
            return self.forward * self.values / self.value
        return np.full(len(self.names), np.nan)

    @property
    def finite(self) -> bool:
        """Whether every step of the run was solved."""
        return bool(np.isfinite(self.value) and np.isfinite(self.forward[self.resolved]).all())

    @property
    def scaled_error(self) -> np.ndarray | None:
        """The error of `scaled` (p,)."""
        if self.error is None or not self.value:
            return None
        return np.abs(self.error * self.values / self.value)

    @property
    def trusted(self) -> bool:
        """Whether every slope is known, valid over the whole run, and predicts the runs along it."""
        along = self.along is None or self.along.status == TRUSTED
        return self.window is None and not self.unclear and along

    @property
    def grows(self) -> str:
        """What grows over the run: `nothing`, `tangent` (small changes, but not those of a size that matters), or
        `motion` (both: chaos). Of a motion whose phase drifts only the latter grow."""
        if self.growth is None or self.growth <= TANGENT_GROWTH:
            return "nothing"
        limit = MOTION_GROWTH if self.method == OF_RUNS else MOTION_GROWTH_RIGID
        if self.motion_growth is not None and self.motion_growth > limit:
            return "motion"
        return "tangent"

    @property
    def mismatch(self) -> float | None:
        """Maximum difference of the two modes, relative to the maximum derivative; None without reverse mode."""
        if self.reverse is None:
            return None
        size = float(np.max(np.abs(self.forward), initial=0.0))
        if size:
            return float(np.max(np.abs(self.forward - self.reverse), initial=0.0)) / size
        return 0.0

    def to_json(self) -> dict[str, Any]:
        """The fields and the properties derived from them."""
        found = asdict(self)
        if self.along is not None:
            found["along"] = self.along._asdict()
        for name in ("scaled", "scaled_error", "unclear", "trusted", "grows"):
            found[name] = getattr(self, name)
        return found


def empty_result(problem: Study, duration: float) -> LocalDerivatives:
    """The study's parameters and quantity, without derivatives."""
    nothing = np.full(len(problem.names), np.nan)
    return LocalDerivatives(
        names=problem.names,
        units=[p.unit for p in problem.parameters],
        values=problem.values,
        of=problem.of.name,
        unit=problem.of.unit,
        value=np.nan,
        forward=nothing,
        horizon=duration,
        duration=duration,
        slope_status=(KNOWN,) * len(problem.names),
    )


def with_status(problem: Study, found: LocalDerivatives, errors: np.ndarray, branched: np.ndarray) -> LocalDerivatives:
    """The result with errors of its slopes and their status, without slopes that are not resolved.

    Args:
        errors: (p,).
        branched: whether a run or start near it is on another branch, of each parameter (p,).
    """
    level = abs(found.value) / np.array([p.scale for p in problem.parameters])
    slopes = np.abs(found.forward)
    # a third of the change, or 0.01 in p/Q dQ/dp, as of exact derivatives (`linear_range`)
    known = errors <= np.maximum(slopes / 3.0, 0.01 * level)
    lost = ~known & (np.fmax(slopes, errors) >= UNRESOLVED_SLOPE * level)
    status = np.where(known, KNOWN, UNCLEAR).astype(object)
    status[branched] = OTHER_BRANCH
    status[lost] = NOT_RESOLVED
    forward = np.where(lost, np.nan, found.forward)
    return replace(found, error=errors, slope_status=tuple(status), forward=forward)
