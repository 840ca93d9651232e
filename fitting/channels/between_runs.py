"""Mean and spread of parameters that each run has separately."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import stdtrit

from fitting.channels.problem import Problem

#: Level of the interval of a mean.
LEVEL = 0.90


@dataclass(frozen=True)
class Between:
    """A parameter over several runs.

    Attributes:
        name: its path.
        mean, std_error, low, high: of the mean, with a 90 % interval.
        spread: tau, the standard deviation between runs.
        values, std_errors: of the runs (n,).
    """

    name: str
    mean: float
    std_error: float
    low: float
    high: float
    spread: float
    values: np.ndarray
    std_errors: np.ndarray


def combine_runs(name: str, values: np.ndarray, covariance: np.ndarray) -> Between:
    """Mean and spread of a parameter from the runs' estimates (n,) and their covariance (n, n); n at least 2.

    Run r has `p_r = mu + u_r`, with u_r of variance tau^2. Its estimate is `b_r`; the covariance C of the estimates
    includes the parameters that runs share. With `V = C + tau^2 I`, and tau^2 by restricted maximum likelihood,

        mu = 1'V^-1 b/(1'V^-1 1),      se^2 = (b - mu)'V^-1 (b - mu)/(n - 1)/(1'V^-1 1),

    and intervals use Student's t with n - 1 degrees of freedom (Hartung and Knapp 2001): with few runs the variance
    between them is itself uncertain. If the errors of runs differ by a factor ten, such intervals cover 84 % instead
    of 90 %.
    """
    n = len(values)
    own = np.sqrt(np.diag(covariance))
    # a typical size, so that the search works in any unit
    top = float(np.var(values, ddof=1) + np.max(own**2)) or 1.0

    def solve_variance(variance: float) -> tuple[float, float, float, float]:
        """Mean, 1'V^-1 1, the weighted sum of squares, minus twice the restricted log likelihood."""
        total = covariance + (variance + 1e-14 * top) * np.eye(n)
        inverse = np.linalg.inv(total)
        weight = inverse.sum()
        mean = inverse.sum(axis=0) @ values / weight
        square = (values - mean) @ inverse @ (values - mean)
        return mean, weight, square, np.linalg.slogdet(total)[1] + np.log(weight) + square

    def cost(log_variance: float) -> float:
        return solve_variance(np.exp(log_variance))[3]

    found = minimize_scalar(cost, bounds=(np.log(1e-8 * top), np.log(1e2 * top)), method="bounded")
    variance = float(np.exp(found.x))
    if solve_variance(0.0)[3] <= found.fun + 1e-9:
        variance = 0.0
    mean, weight, square, _ = solve_variance(variance)
    scatter = square / (n - 1)
    if variance == 0.0:  # runs that agree better than their errors do not make the mean surer
        scatter = max(scatter, 1.0)
    error = np.sqrt(scatter / weight)
    reach = stdtrit(n - 1, 0.5 + LEVEL / 2) * error
    spread = np.sqrt(variance)
    return Between(name, mean, error, mean - reach, mean + reach, spread, np.asarray(values), own)


def over_runs(problem: Problem, values: np.ndarray, covariance: np.ndarray) -> tuple[Between, ...]:
    """Mean and spread of every parameter that runs have separately, from all values (p,) and their covariance."""
    found = []
    for p, numbers in zip(problem.plain, np.transpose(problem.of_run), strict=True):
        if numbers[0] != numbers[-1]:  # the runs do not share it
            found.append(combine_runs(p.name, values[numbers], covariance[np.ix_(numbers, numbers)]))
    return tuple(found)
