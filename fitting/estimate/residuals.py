"""The problem of an estimator in blocks: what an estimator asks of windows of traces, or of whole runs of channels."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.noise import Noise
from fitting.estimate.normal_equations import Evaluation, Gaps, Normal, Prior, normal_blocks, prior_of
from fitting.estimate.windows import Starts, Windows
from fitting.parameters.parameter import Parameter
from fitting.parameters.rig_priors import JointPrior


class Descent(Protocol):
    """How parameters move to a minimum, if not by Gauss-Newton steps (`descent.GradientDescent`)."""

    def mover(self, objective: Any, count: int) -> Any:
        """The mover (`least_squares.Mover`) between points on an `Objective`, after this number of evaluations."""


class Estimate(Protocol):
    """What a problem needs of a point that an estimator has reached, a `solution.Solution`.

    Attributes:
        values: parameters (k,).
        starts: unknowns of the blocks.
        evaluation: at this point.
        weights: robust weights (K, S, n).
    """

    values: np.ndarray
    starts: Starts
    evaluation: Any
    weights: np.ndarray


class Timing(NamedTuple):
    """When the residuals of K blocks of S samples were measured.

    Attributes:
        t: times (K, S) [s].
        run: their runs (K, S).
        known: which samples exist (K, S) bool.
        begin: starts of the runs (R,) [s].
        duration: total time covered by residuals [s].
        blocks: number of blocks.
    """

    t: np.ndarray
    run: np.ndarray
    known: np.ndarray
    begin: np.ndarray
    duration: float
    blocks: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Residuals(ABC):
    """A least-squares problem: residuals of K blocks by shared parameters p and each block's own unknowns z_k.

        minimise  sum loss(r_k(z_k, p)) + priors,      p (k,), z_k (m2,), r_k (S, n) in units of independent noise

    Windows of traces (`Problem`) have starts of their own; whole runs of channels (`channels.problem.Problem`) are one
    block without unknowns, m2 = 0. Steps, noise, errors and refinement are written for both.

    Attributes:
        parameters: bounds and priors (k,).
        frozen: parameters that keep their start values (k,) bool; None: none. They may lie on their bounds.
        memory: number of samples that carry as much information as one with independent error. A fit has converged if
            the remaining step is small compared with the correspondingly larger errors.
        known: joint prior knowledge of several parameters, or of none that is free.
        descent: how the parameters move; None for Gauss-Newton steps.
        windows: the samples and their noise.
        noise: its origin, if it was estimated.
    """

    #: Minimum variance of residuals, in units of the noise, for the computation of errors.
    least_variance: ClassVar[float] = 0.0

    parameters: tuple[Parameter, ...]
    loss: Loss = LEAST_SQUARES
    frozen: np.ndarray | None = None
    memory: float = 1.0
    known: JointPrior = JointPrior()
    descent: Descent | None = None
    windows: Windows
    noise: Noise | None = None

    @property
    @abstractmethod
    def freedoms(self) -> int:
        """Number m2 of a block's own unknowns."""

    @property
    def samples(self) -> int:
        """Residuals in all."""
        return int(self.sample_mask.sum())

    @property
    def sample_mask(self) -> np.ndarray:
        """Which residuals exist (K, S, n) bool."""
        return self.windows.weight > 0

    @property
    @abstractmethod
    def order(self) -> int:
        """Order of the scheme in the time step."""

    @property
    @abstractmethod
    def finest(self) -> bool:
        """Whether the time step is finer than a fit may use."""

    @abstractmethod
    def evaluate(self, values: np.ndarray, starts: Starts) -> Evaluation:
        """Residuals (K, S, n) and derivatives (K, S, n, m2 + k) at parameters (k,) and unknowns of the blocks."""

    @abstractmethod
    def move_starts(self, starts: Starts, values: np.ndarray, dz: np.ndarray) -> Starts:
        """The blocks' unknowns after a step dz (K, m2)."""

    @abstractmethod
    def finer(self) -> Residuals:
        """The problem with half the time step."""

    @abstractmethod
    def raw_evaluation(self, point: Estimate, claimed: Windows) -> Evaluation:
        """The evaluation of a solution in units of the claimed noise, without whitening."""

    @abstractmethod
    def timing(self) -> Timing:
        """Times of the samples."""

    @abstractmethod
    def correlation(self, point: Estimate) -> tuple[np.ndarray, bool]:
        """Correlation of neighbouring weighted residuals (c,), of all or by channel; whether it is significant."""

    def with_noise(self, noise: Noise, windows: Windows, values: np.ndarray) -> Residuals:
        """The problem with this noise, which its samples have; `values` (k,) are those of the parameters."""
        return replace(self, windows=windows, noise=noise)

    def gaps(self, evaluation: Evaluation, values: np.ndarray) -> Gaps:
        """Scaled gaps between consecutive blocks, of problems whose blocks follow each other."""
        raise NotImplementedError

    def failure(self, evaluation: Evaluation) -> str:
        """Why an evaluation has no finite residuals, if known."""
        return ""

    @property
    def explains_residuals(self) -> bool:
        """Whether the noise explains the residuals."""
        return True

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return [p.name for p in self.parameters]

    @property
    def held_mask(self) -> np.ndarray:
        """Which parameters are fixed (k,) bool."""
        if self.frozen is None:
            return np.zeros(len(self.parameters), bool)
        return self.frozen

    def bounds(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Minimum and maximum values (k,), both those of `values` for fixed parameters."""
        low = np.array([p.low for p in self.parameters])
        high = np.array([p.high for p in self.parameters])
        return np.where(self.held_mask, values, low), np.where(self.held_mask, values, high)

    def step_bounds(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Maximum change of the parameters in one step (k,), in both directions."""
        low, high = self.bounds(values)
        return low - values, high - values

    def after_step(self, values: np.ndarray, dp: np.ndarray) -> np.ndarray:
        """The parameters (k,) after a step, inside their bounds."""
        return np.clip(values + dp, *self.bounds(values))

    def prior(self, values: np.ndarray) -> Prior:
        """Contribution of the priors."""
        return prior_of(self.parameters, values, self.known.common)

    def data_cost(self, evaluation: Evaluation) -> float:
        """The loss of the residuals; infinite if the motion is not finite."""
        if np.isfinite(evaluation.residual).all():
            return self.loss.cost(evaluation.residual)
        return np.inf

    def weights(self, evaluation: Evaluation) -> np.ndarray:
        """The loss's weights (K, S, n)."""
        return self.loss.weights(evaluation.residual)

    def normal(self, evaluation: Evaluation) -> Normal:
        """Normal equations of the residuals."""
        return normal_blocks(evaluation, self.weights(evaluation), self.freedoms)
