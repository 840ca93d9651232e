"""The fit of windows of traces: residuals of the simulated angles, starts of the windows, and gaps between them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fitting.estimate.neighbour_correlation import is_correlated, lag_one
from fitting.estimate.noise import Noise
from fitting.estimate.normal_equations import Evaluation, Gaps, Prior
from fitting.estimate.residuals import Estimate, Residuals, Timing
from fitting.estimate.rest import Rest
from fitting.estimate.simulator import Simulator
from fitting.estimate.whitening import in_noise_units, whiten
from fitting.estimate.windows import Starts, Windows
from fitting.traces.planar import chart, wrap

#: Minimum correlation of neighbouring residuals that counts in standard errors.
CORRELATION_FLOOR = 0.05
#: chi-square per degree of freedom above which the stated noise does not explain the residuals.
UNEXPLAINED_CHI_SQUARE = 1.5
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
        return np.mean(self.noise.factor**2) < UNEXPLAINED_CHI_SQUARE

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

    def correlation(self, point: Estimate) -> tuple[np.ndarray, bool]:
        """Correlation of neighbours, of all links together."""
        correlation, error = lag_one(point.weights * point.evaluation.residual, self.sample_mask)
        return np.array([correlation]), is_correlated(abs(correlation), error, 4.0, CORRELATION_FLOOR)

    def evaluate(self, values: np.ndarray, starts: Starts) -> Evaluation:
        """All windows at parameter values (k,) and starts, residuals and derivatives in units of independent noise."""
        return whiten(self.windows, self.simulator(values, starts, self.windows))

    def raw_evaluation(self, point: Estimate, claimed: Windows) -> Evaluation:
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
