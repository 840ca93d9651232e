"""The end of an estimator: estimates with the evaluation, the normal equations and the status there."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from fitting.estimate.normal_equations import Evaluation
from fitting.estimate.residuals import Residuals
from fitting.estimate.windows import Starts, Windows
from fitting.traces.planar import wrap


class Visited(NamedTuple):
    """A point of a descent: its cost, the parameters, the loss per sample, and the gap weight of joined windows."""

    cost: float
    values: list[float]
    loss: float
    gap_weight: float | None


#: The kinds of problem and evaluation of a solution: of traces (`Problem`), or of channels.
ProblemType = TypeVar("P", bound=Residuals)
EvaluationType = TypeVar("E")


@dataclass
class Solution(Generic[ProblemType, EvaluationType]):
    """End of an estimator.

    Attributes:
        problem: its problem, with the windows (their noise, their substeps) used last.
        values: parameters (k,).
        starts: window starts.
        evaluation: at this point.
        weights: robust weights (K, S, n), 1 for least squares; those of the fit's end along its linear model too.
        cost: 1/2 chi-square, with prior and gaps.
        information: S (k, k), the inverse of the covariance for noise of standard deviation sigma.
        gradient: of the cost by the parameters (k,), along the optimum of the starts.
        eliminated: dz/dp along the optimum of the starts (K, m2, k).
        status: `ok` or `not_converged`; with `message`, which an `ok` fit has if its cost is non-smooth.
        iterations: number of evaluations.
        history: the points of the descent.
        gap_weight: standard deviation allowed between windows, in units of their scale; None if they are free.
        evidence: logarithm of the gap weight's evidence, up to constants; NaN if it was not computed.
        step_bias: shift of the parameters (k,) by the time step, in standard errors, to first order.
    """

    problem: ProblemType
    values: np.ndarray
    starts: Starts
    evaluation: EvaluationType
    weights: np.ndarray
    cost: float
    information: np.ndarray
    gradient: np.ndarray
    eliminated: np.ndarray
    status: str = "not_converged"
    message: str = ""
    iterations: int = 0
    history: list[Visited] = field(default_factory=list)
    gap_weight: float | None = None
    evidence: float = np.nan
    step_bias: np.ndarray | None = None

    @property
    def windows(self) -> Windows:
        return self.problem.windows

    @property
    def by_name(self) -> dict[str, float]:
        """Values of the parameters by their names."""
        return dict(zip(self.problem.names, map(float, self.values), strict=True))

    @property
    def free(self) -> np.ndarray:
        """Numbers of the parameters that are not fixed."""
        return np.flatnonzero(~self.problem.held_mask)

    @property
    def free_information(self) -> np.ndarray:
        """Information of the parameters that are not fixed."""
        return self.information[np.ix_(self.free, self.free)]

    @property
    def chi2(self: Solution[ProblemType, Evaluation]) -> float:
        """Sum of squared weighted residuals of the measured angles."""
        return np.sum(self.weights * self.evaluation.residual**2)

    @property
    def errors(self: Solution[ProblemType, Evaluation]) -> np.ndarray:
        """Simulated minus measured angles (K, S, n) [rad], 0 where there is no sample."""
        off = wrap(self.evaluation.theta - self.windows.theta)
        return np.where(self.windows.known, off, 0.0)

    @property
    def rms(self: Solution[ProblemType, Evaluation]) -> float:
        """RMS of the errors [rad]."""
        return np.sqrt(np.sum(self.errors**2) / self.windows.samples)
