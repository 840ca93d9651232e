"""The problem that an estimator minimises, and its solution."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.neighbour_correlation import is_correlated, lag_one
from fitting.estimate.noise import Noise
from fitting.estimate.normal_equations import Evaluation, Gaps, Normal, Prior, normal_blocks, prior_of
from fitting.estimate.rest import Rest
from fitting.estimate.simulator import Simulator
from fitting.estimate.whitening import in_noise_units, whiten
from fitting.estimate.windows import Starts, Windows
from fitting.parameters.parameter import Parameter
from fitting.parameters.rig_priors import JointPrior
from fitting.traces.planar import chart, wrap

#: Minimum correlation of neighbouring residuals that counts in standard errors.
CORRELATION_FLOOR = 0.05
#: chi-square per degree of freedom below which the stated noise is too large, and above which it does not explain the
#: residuals.
CHI2_RANGE = (0.5, 1.5)


class Descent(Protocol):
    """How parameters move to a minimum, if not by Gauss-Newton steps (`descent.GradientDescent`)."""

    def mover(self, objective: Any, count: int) -> Any:
        """The mover (`least_squares.Mover`) between points on an `Objective`, after this number of evaluations."""


class Timing(NamedTuple):
    """Sampling: times [s], runs and existing samples (K, S); starts of the runs (R,) [s], total time covered by
    residuals [s], number of blocks."""

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
    def raw_evaluation(self, point: Solution, claimed: Windows) -> Evaluation:
        """The evaluation of a solution in units of the claimed noise, without whitening."""

    @abstractmethod
    def timing(self) -> Timing:
        """Times of the samples."""

    @abstractmethod
    def correlation(self, point: Solution) -> tuple[np.ndarray, bool]:
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


#: Maximum angle [rad] and rate [rad/s] by which one step may move a start.
LARGEST_MOVE = (0.5, 10.0)
#: Maximum number of substeps of a step.
MOST_SUBSTEPS = 16
#: Sizes of a gap in angle [rad] and rate [rad/s] that weight 1 allows.
GAP_SCALE = (0.1, 1.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem(Residuals):
    """Fit of windows by parameters.

    Attributes:
        rest: information from poses at rest (`rest.Rest`).
    """

    simulator: Simulator
    rest: Rest | None = None

    @property
    def freedoms(self) -> int:
        """Numbers of a window's start."""
        return self.simulator.freedoms

    @property
    def order(self) -> int:
        """Order of the windows' scheme."""
        return self.simulator.stepper.integrator.order

    @property
    def finest(self) -> bool:
        """Whether there are more than `MOST_SUBSTEPS` substeps."""
        return self.windows.substeps > MOST_SUBSTEPS

    @property
    def explains_residuals(self) -> bool:
        """Whether the noise of the traces, or noise of another kind, explains the residuals.

        Smaller residuals count as explained: noise estimated from differences is an upper limit for fast links.
        """
        if self.noise is None or self.noise.kind != "white":
            return True
        return np.mean(self.noise.factor**2) < CHI2_RANGE[1]

    def move_starts(self, starts: Starts, values: np.ndarray, dz: np.ndarray) -> Starts:
        """Starts after a step in the chart, each window's move limited to `LARGEST_MOVE`; not yet closed."""
        bases = chart(self.simulator.model_at(values), starts.theta)
        moves = dz.reshape(len(dz), 2, -1)  # of angles and of rates
        most = np.max(np.abs(moves).max(axis=2) / LARGEST_MOVE, axis=1)
        moves = moves / np.maximum(most, 1.0)[:, None, None]
        theta = starts.theta + np.einsum("kij,kj->ki", bases, moves[:, 0])
        omega = starts.omega + np.einsum("kij,kj->ki", bases, moves[:, 1])
        return Starts(theta, omega)

    def gaps(self, evaluation: Evaluation, values: np.ndarray) -> Gaps:
        """Scaled gaps between consecutive windows."""
        right = np.flatnonzero(self.windows.follows)
        left = right - 1
        n = evaluation.start.shape[1] // 2
        m2 = self.freedoms
        turn = chart(self.simulator.model_at(values), evaluation.start[right, :n]).mT
        rows = np.zeros((len(left), m2, 2 * n))
        rows[:, : m2 // 2, :n] = turn / GAP_SCALE[0]
        rows[:, m2 // 2 :, n:] = turn / GAP_SCALE[1]
        # the standard deviation that a gap allows grows as the root of time
        rows /= np.sqrt(self.windows.lengths[left] / self.windows.lengths.mean())[:, None, None]
        difference = evaluation.end[left] - evaluation.start[right]
        difference[:, :n] = wrap(difference[:, :n])
        end = rows @ evaluation.end_jacobian[left]
        start = rows @ evaluation.start_jacobian[right]
        value = np.einsum("gij,gj->gi", rows, difference)
        return Gaps(left, value, end[..., :m2], -start[..., :m2], end[..., m2:] - start[..., m2:])

    def timing(self) -> Timing:
        """Times of the windows' samples."""
        windows = self.windows
        begin = np.full(int(windows.run.max()) + 1, np.inf)
        np.minimum.at(begin, windows.run, windows.begin)
        known = np.any(self.sample_mask, axis=2)
        times = windows.times()
        run = np.broadcast_to(windows.run[:, None], times.shape)
        return Timing(times, run, known, begin, windows.lengths.sum(), windows.count)

    def correlation(self, point: Solution) -> tuple[np.ndarray, bool]:
        """Correlation of neighbours, of all links together."""
        correlation, error = lag_one(point.weights * point.evaluation.residual, self.sample_mask)
        return np.array([correlation]), is_correlated(abs(correlation), error, 4.0, CORRELATION_FLOOR)

    def evaluate(self, values: np.ndarray, starts: Starts) -> Evaluation:
        """All windows at parameter values (k,) and starts, residuals and derivatives in units of independent noise."""
        return whiten(self.windows, self.simulator(values, starts, self.windows))

    def raw_evaluation(self, point: Solution, claimed: Windows) -> Evaluation:
        """The evaluation in units of the claimed noise; windows with memory or delays are simulated again."""
        if self.windows.decay is None and self.windows.jitter is None:
            return in_noise_units(point.evaluation, self.windows, claimed)
        return self.simulator(point.values, point.starts, claimed)

    def with_noise(self, noise: Noise, windows: Windows, values: np.ndarray) -> Problem:
        """The problem with this noise, also in the poses at rest."""
        rest = self.rest
        if rest is not None:
            rest = rest.with_noise(noise, self.simulator, values)
        return replace(self, windows=windows, noise=noise, rest=rest)

    def prior(self, values: np.ndarray) -> Prior:
        """Contribution of the priors and the poses at rest."""
        found = super().prior(values)
        if self.rest is None:
            return found
        more = self.rest.prior(self.simulator, values)
        return Prior(found.cost + more.cost, found.gradient + more.gradient, found.curvature + more.curvature)

    def finer(self) -> Problem:
        """The problem with half the time step."""
        return replace(self, windows=replace(self.windows, substeps=2 * self.windows.substeps))


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
    def chi2(self: Solution[Problem, Evaluation]) -> float:
        """Sum of squared weighted residuals of the measured angles."""
        return np.sum(self.weights * self.evaluation.residual**2)

    @property
    def errors(self: Solution[Problem, Evaluation]) -> np.ndarray:
        """Simulated minus measured angles (K, S, n) [rad], 0 where there is no sample."""
        off = wrap(self.evaluation.theta - self.windows.theta)
        return np.where(self.windows.known, off, 0.0)

    @property
    def rms(self: Solution[Problem, Evaluation]) -> float:
        """RMS of the errors [rad]."""
        return np.sqrt(np.sum(self.errors**2) / self.windows.samples)
