"""What an estimator minimises, and where it ended."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from fitting.estimate.evaluation import Evaluation
from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.noise import Noise
from fitting.estimate.normal_equations import Normal, Prior, normal_blocks, prior_of
from fitting.estimate.rest import Rest
from fitting.estimate.simulator import Simulator
from fitting.estimate.whitening import whitened
from fitting.estimate.windows import Starts, Windows
from fitting.parameters.parameter import Parameter
from fitting.parameters.priors import Known

#: chi-square per degree of freedom outside which the noise does not explain the residuals.
CHI2_RANGE = (0.5, 1.5)


def wrapped(angle: np.ndarray) -> np.ndarray:
    """The angle as the shortest turn, in [-pi, pi] [rad]."""
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))


class Descent(Protocol):
    """How parameters move to a minimum, where not by Gauss-Newton steps (`gradient.GradientDescent`)."""

    def descend(self, objective: Any, values: np.ndarray, starts: Starts, evaluation: Evaluation, **rest: Any) -> Any:
        """The solution from a point that is evaluated; arguments as of `gauss_newton.descend`."""


@dataclass(frozen=True)
class Problem:
    """Windows to follow, by which parameters.

    Attributes:
        parameters: bounds and priors (k,).
        frozen: parameters that are held where they start (k,) bool; None holds none. They may lie on their bounds.
        memory: samples that tell as much as one whose error has nothing to do with its neighbours'; a fit is converged
            when what is left to go is little against errors that are as much larger.
        known: what is known of several parameters together, or of none that is free.
        rest: what poses at rest tell (`rest.Rest`).
        noise: what the windows' weights are made of, where it was estimated (`noise.Noise`).
        descent: how the parameters move; None for Gauss-Newton steps.
    """

    simulator: Simulator
    windows: Windows
    parameters: tuple[Parameter, ...]
    loss: Loss = LEAST_SQUARES
    frozen: np.ndarray | None = None
    noise: Noise | None = None
    memory: float = 1.0
    known: Known = Known()
    rest: Rest | None = None
    descent: Descent | None = None

    @property
    def freedoms(self) -> int:
        """Numbers of a window's start."""
        return self.simulator.freedoms

    @property
    def explained(self) -> bool:
        """Whether the noise that the traces show, or one of another kind, explains the residuals.

        Smaller residuals are explained: noise read from differences is an upper limit where links are fast.
        """
        if self.noise is None or self.noise.kind != "white":
            return True
        return float(np.mean(self.noise.factor**2)) < CHI2_RANGE[1]

    @property
    def held(self) -> np.ndarray:
        """Which parameters are held (k,) bool."""
        return np.zeros(len(self.parameters), bool) if self.frozen is None else self.frozen

    def bounds(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest values (k,), both those of `values` where a parameter is held."""
        low, high = np.array([p.low for p in self.parameters]), np.array([p.high for p in self.parameters])
        return np.where(self.held, values, low), np.where(self.held, values, high)

    def evaluate(self, values: np.ndarray, starts: Starts) -> Evaluation:
        """All windows at parameter values (k,) and starts, residuals and derivatives in units of independent noise."""
        return whitened(self.windows, self.simulator(values, starts, self.windows))

    def prior(self, values: np.ndarray) -> Prior:
        """What the priors and the poses at rest add."""
        found = prior_of(self.parameters, values, self.known.common)
        if self.rest is None:
            return found
        return Prior(*(a + b for a, b in zip(found, self.rest.prior(self.simulator, values), strict=True)))

    def data_cost(self, evaluation: Evaluation) -> float:
        """The loss of the measured angles; infinite where the motion is not finite."""
        if not np.isfinite(evaluation.residual).all():
            return np.inf
        return self.loss.cost(evaluation.residual)

    def weights(self, evaluation: Evaluation) -> np.ndarray:
        """The loss's weights (K, S, n)."""
        return self.loss.weights(evaluation.residual)

    def normal(self, evaluation: Evaluation) -> Normal:
        """Normal equations of the measured angles."""
        return normal_blocks(evaluation, self.weights(evaluation), self.freedoms)

    def finer(self) -> Problem:
        """The same with half the time step."""
        return replace(self, windows=replace(self.windows, substeps=2 * self.windows.substeps))


@dataclass
class Solution:
    """Where an estimator ended.

    Attributes:
        problem: what it minimised, with the windows (their noise, their substeps) it used last.
        values: parameters (k,).
        starts: window starts.
        evaluation: at this point.
        weights: robust weights (K, S, n), 1 for least squares.
        cost: 1/2 chi-square, with prior and gaps.
        information: S (k, k), the inverse of the covariance for noise of deviation sigma.
        eliminated: dz/dp along the optimum of the starts (K, m2, k).
        status: `ok` or `not_converged`; with `message`, which an `ok` fit has where its cost is rough.
        iterations: evaluations made.
        history: one line per iteration: cost, values.
        gap_weight: deviation allowed between windows, in units of their scale; None where they are free.
        step_bias: what the time step moves the parameters (k,) by, in standard errors, to first order.
    """

    problem: Problem
    values: np.ndarray
    starts: Starts
    evaluation: Evaluation
    weights: np.ndarray
    cost: float
    information: np.ndarray
    gradient: np.ndarray
    eliminated: np.ndarray
    status: str = "not_converged"
    message: str = ""
    iterations: int = 0
    history: list[dict[str, Any]] = field(default_factory=list)
    gap_weight: float | None = None
    evidence: float | None = None
    step_bias: np.ndarray | None = None

    @property
    def windows(self) -> Windows:
        return self.problem.windows

    @property
    def chi2(self) -> float:
        """Sum of squared weighted residuals of the measured angles."""
        return float(np.sum(self.weights * self.evaluation.residual**2))

    @property
    def errors(self) -> np.ndarray:
        """Simulated less measured angles (K, S, n) [rad], 0 where there is no sample."""
        return np.where(self.windows.weight > 0, wrapped(self.evaluation.theta - self.windows.theta), 0.0)

    @property
    def rms(self) -> float:
        """RMS of the errors [rad]."""
        return float(np.sqrt(np.sum(self.errors**2) / (self.windows.weight > 0).sum()))
