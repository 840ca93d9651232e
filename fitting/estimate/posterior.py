"""The posterior of the parameters by importance sampling from an optimum, the window starts integrated at each draw.

    log pi(p) = -cost(p, z*(p))/unit - 1/2 log det H_zz(p),      z*(p) the best starts with the parameters fixed at p

Draws come from Student's t with 5 degrees of freedom around the optimum, with the covariance that the fit reports. The
integral over the starts is Laplace's (Tierney and Kadane 1986), which is exact if the motion is linear in them.

Importance weights with a smoothed tail, and the tail's shape, which shows whether they are reliable.

The largest weights are replaced by quantiles of a generalised Pareto law fitted to them (Vehtari, Simpson, Gelman, Yao
and Gabry 2024, "Pareto smoothed importance sampling"); its shape is fitted as in Zhang and Stephens (2009). A shape
above 0.7 means that the proposal misses regions of high weight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import softmax

from dropper_jax.base.errors import Progress, SceneError, silent
from fitting.estimate.problem import Solution
from fitting.estimate.shooting import level_of
from fitting.estimate.uncertainty import degrees_of_freedom, uncertainty

#: Shape above which averages with these weights are unreliable.
TRUSTED = 0.7
#: Shape towards which a short tail is regularised, and the number of weights that it counts as.
SHORT_TAIL, COUNTS = 0.5, 10


def smooth_weights(log_ratio: np.ndarray) -> tuple[np.ndarray, float]:
    """Weights (N,) that add to 1, and the shape of their tail, from log density over log proposal (N,).

    Non-finite entries have no weight. With fewer than five weights in the tail, the shape is infinite.
    """
    finite = np.isfinite(log_ratio)
    weight = np.zeros(len(log_ratio))
    if not finite.any():
        return weight, np.inf
    weight[finite] = np.exp(log_ratio[finite] - log_ratio[finite].max())
    count = int(finite.sum())
    tail = int(np.ceil(min(0.2 * count, 3 * np.sqrt(count))))
    shape = np.inf
    if tail >= 5:
        order = np.argsort(weight)
        largest, cut = order[-tail:], weight[order[-tail - 1]]
        excess = weight[largest] - cut
        shape = 0.0
        if excess[-1] > 1e-12 and excess[max(int(tail / 4 + 0.5) - 1, 0)] > 0:  # otherwise all weights are equal
            from scipy.stats import genpareto  # noqa: PLC0415 - slow to import, and few fits sample

            shape, scale = pareto(excess)
            plotting_position = (np.arange(1, tail + 1) - 0.5) / tail
            weight[largest] = np.minimum(genpareto.ppf(plotting_position, shape, cut, scale), 1.0)
    return weight / weight.sum(), shape


def pareto(excess: np.ndarray) -> tuple[float, float]:
    """Shape and scale of a generalised Pareto law from a sorted sample (n,) above its threshold."""
    n = len(excess)
    many = 30 + int(np.sqrt(n))
    b = 1 / excess[-1] + (1 - np.sqrt(many / (np.arange(1, many + 1) - 0.5))) / (3 * excess[int(n / 4 + 0.5) - 1])
    shapes = np.log1p(-b[:, None] * excess).mean(axis=1)
    mean = float(b @ softmax(n * (np.log(-b / shapes) - shapes)))
    shape = float(np.log1p(-mean * excess).mean())
    return (n * shape + COUNTS * SHORT_TAIL) / (n + COUNTS), -shape / mean


#: Evaluations at a draw, and permitted remaining gain of log pi by the starts.
EVALUATIONS, LEFT = 5, 0.05
#: Effective draws below which quantiles are unreliable.
FEW = 50


@dataclass(frozen=True)
class Posterior:
    """Weighted draws of the free parameters.

    Attributes:
        names: of the parameters (k,).
        draws: (N, k).
        weight: (N,), adds to 1.
        shape: of the weights' tail (Pareto k); reliable below 0.7.
        unsolved: draws whose starts were not found, which have no weight.
    """

    names: tuple[str, ...]
    draws: np.ndarray
    weight: np.ndarray
    shape: float
    unsolved: int = 0

    @property
    def effective(self) -> float:
        """Equivalent number of draws of equal weight."""
        return float(1 / max(np.sum(self.weight**2), 1e-300))

    @property
    def mean(self) -> np.ndarray:
        """(k,)."""
        return self.weight @ self.draws

    @property
    def std(self) -> np.ndarray:
        """(k,)."""
        return np.sqrt(np.maximum(self.weight @ (self.draws - self.mean) ** 2, 0.0))

    def quantile(self, p: float) -> np.ndarray:
        """(k,), linear in the cumulative weight between draws."""
        order = np.argsort(self.draws, axis=0)
        below = np.cumsum(self.weight[order], axis=0) - 0.5 * self.weight[order]
        ordered = np.take_along_axis(self.draws, order, axis=0)
        return np.array([np.interp(p, *column) for column in zip(below.T, ordered.T, strict=True)])

    def to_json(self) -> dict[str, Any]:
        """Mean, standard deviation and quantiles by name; their reliability."""
        columns = (self.mean, self.std, *(self.quantile(p) for p in (0.05, 0.5, 0.95)))
        keys = ("mean", "std", "low", "median", "high")
        rows = zip(self.names, *columns, strict=True)
        parameters = {name: dict(zip(keys, numbers, strict=True)) for name, *numbers in rows}
        quality = {"pareto_k": self.shape, "effective_draws": self.effective, "draws": len(self.draws)}
        return quality | {"parameters": parameters}

    @property
    def warnings(self) -> list[str]:
        """Reasons not to trust it, one line each."""
        found = []
        if not self.shape < TRUSTED:
            found.append(
                f"posterior: Pareto k is {self.shape:.2g}, its quantiles are not to be trusted above {TRUSTED:g}: the "
                "posterior is far from normal, or the parameters are not identifiable"
            )
        elif self.effective < FEW:
            found.append(f"posterior: {self.effective:.0f} effective draws; quantiles unreliable below {FEW}")
        if self.unsolved > 0.05 * len(self.draws):
            found.append(f"posterior: the starts of {self.unsolved} of {len(self.draws)} draws were not found")
        return found


def importance(solution: Solution, draws: int = 200, seed: int = 0, progress: Progress = silent) -> Posterior:
    """Sample the posterior of a converged solution's free parameters.

    Args:
        draws: N, each with one to three evaluations of all windows.

    Raises:
        SceneError: nothing is free, or too few draws.
    """
    from scipy.stats import multivariate_t  # noqa: PLC0415 - slow to import, and few fits sample

    problem = solution.problem
    free = np.flatnonzero(~problem.held_mask)
    if not len(free):
        raise SceneError("posterior: no parameter is free; allowed: at least one")
    if draws < 2 * FEW:
        raise SceneError(f"posterior: {draws} draws are too few for quantiles; allowed: at least {2 * FEW}")
    u = uncertainty(solution)
    unit = solution.chi2 / degrees_of_freedom(solution) * max(u.inflation, 1.0) ** 2
    # degrees of freedom of the proposal, whose tails must not be shorter than the posterior's
    proposal = multivariate_t(
        solution.values[free], u.covariance[np.ix_(free, free)], df=5, allow_singular=True, seed=seed
    )
    low, high = (end[free] for end in problem.bounds(solution.values))
    points = np.reshape(proposal.rvs(draws), (draws, len(free)))
    along = Along(solution)
    log_ratio = np.full(draws, -np.inf)
    inside = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    for i in inside:
        progress(i / draws, f"posterior: draw {i + 1} of {draws}")
        values = solution.values.copy()
        values[free] = points[i]
        log_ratio[i] = along(values, unit) - proposal.logpdf(points[i])
    unsolved = int(np.isnan(log_ratio).sum())
    names = tuple(problem.parameters[i].name for i in free)
    return Posterior(names, points, *smooth_weights(log_ratio), unsolved)


class Along:
    """The log density of parameters with the starts integrated, near a solution."""

    def __init__(self, solution: Solution) -> None:
        held = np.ones(len(solution.values), bool)
        self.solution, self.level = solution, level_of(replace(solution.problem, frozen=held), solution.gap_weight)

    def __call__(self, values: np.ndarray, unit: float) -> float:
        """log pi (k,) minus a constant; NaN if the starts are not found."""
        point, level = self.solution, self.level
        along = point.eliminated @ (values - point.values)
        starts = point.problem.move_starts(point.starts, point.values, along)
        best = (np.inf, np.inf, 0.0)
        for _ in range(EVALUATIONS):
            evaluation = level.problem.evaluate(values, starts)
            cost = level.cost(evaluation, values)
            system = level.system(evaluation, values) if np.isfinite(cost) else None
            step = None if system is None else level.solve(system, values, 0.0, *np.zeros((2, len(values))))
            if step is None:
                return np.nan
            if cost - step.predicted < best[0]:
                volume = step.log_determinant
                volume = float(np.linalg.slogdet(system.A)[1].sum()) if volume is None else volume
                best = cost - step.predicted, step.predicted, volume
            if step.predicted < LEFT * unit:
                break
            starts = level.problem.move_starts(evaluation.starts, values, step.dz)
        # the predicted gain of a last step is included
        return np.nan if best[1] > unit else -best[0] / unit - 0.5 * best[2]
