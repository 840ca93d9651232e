"""What the estimators work on: the fitted samples of the traces, their windows, and the model with its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.load.scene import Scene
from fitting.estimate.first_starts import first_starts
from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.noise import Noise
from fitting.estimate.residuals import Descent
from fitting.estimate.rest import Rest
from fitting.estimate.simulator import Simulator
from fitting.estimate.solution import Solution
from fitting.estimate.window_problem import Problem
from fitting.estimate.windows import Piece, Span, Starts, Windows, cut, fill
from fitting.parameters.parameter import Parameter
from fitting.parameters.rig_priors import JointPrior, rig_priors
from fitting.traces.trace import Trace
from fitting.windows.spans import Interval

#: Steps per period of the shortest link as a pendulum, by the scheme's order: 1/120 s for the lab dropper (error after
#: 1 s 1.6e-5 rad) at order 4; second order takes more; a fit that needs finer steps halves it.
#: Schemes with error control save at least this often, for the cubics between.
STEPS_PER_PERIOD = {8: 38, 5: 38, 4: 75, 2: 200}


@dataclass(frozen=True)
class Samples:
    """The samples of the traces that are fitted.

    Attributes:
        traces: in the model's convention; their standard errors include the model error.
        spans: of the fitted samples.
        sigma: noise of each run's links (n,) [rad].
        held_out: (from, to) [s] that are scored.
        rest: poses at rest.
        period: of the shortest link as a pendulum [s].
        warnings: for the user.
    """

    traces: list[Trace]
    spans: list[Span]
    sigma: list[np.ndarray]
    held_out: tuple[Interval, ...]
    rest: Rest | None
    period: float
    warnings: tuple[str, ...]

    @property
    def fitted(self) -> list[Trace]:
        """The traces without held-out samples, which affect nothing, not even the first guess of a start."""
        return fitted_parts(self.traces, self.spans)

    @property
    def interval(self) -> float:
        """Longest sampling interval of the traces [s]."""
        return max(trace.interval for trace in self.traces)


def fitted_parts(traces: Sequence[Trace], spans: Sequence[Span]) -> list[Trace]:
    """The traces with every sample outside the spans (run, from, to) [s] marked as missing."""
    parts = []
    for i, trace in enumerate(traces):
        own_spans = [span for span in spans if span.run == i]
        recordings = tuple(_part(recording, own_spans) for recording in trace.recordings)
        parts.append(replace(_part(trace, own_spans), recordings=recordings))
    return parts


def _part(trace: Trace, spans: Sequence[Span]) -> Trace:
    """A trace with every sample outside the spans, of any run, marked as missing."""
    inside = np.zeros(len(trace.t), bool)
    for span in spans:
        inside |= (trace.t >= span.low - 1e-9) & (trace.t < span.high - 1e-9)
    return replace(trace, theta=np.where(inside[:, None], trace.theta, np.nan))


@dataclass(frozen=True)
class Prepared(Samples):
    """Everything that an estimator needs: the result of `prepare`.

    Attributes:
        scene: with zero for a coefficient of damping that is free and that it lacks.
        parameters: the free ones, with their start values.
        simulator: its programs know the parameters.
        windows, starts: of the fitted samples, and where a fit starts.
        lyapunov: growth rate of small errors in the motion [1/s].
        started, compiled_before: clock [s] at the start, and compile time of the simulator before it.
        noise: estimated by an earlier fit; None: as the traces claim.
        known: prior knowledge of several parameters together.
        begin: values (k,) where a fit starts; None: the parameters' own.
        left_out: (run, from, to) of windows that are not fitted because no start explains them.
        outliers: samples that are not fitted, in words: each alone is far from the motion of its window.
        breaks: (run, time) where the motion jumps, so that windows are not joined there.
        iterations: evaluations used so far.
        first_noise: noise at the start of a fit, if links are missed by different multiples of their claimed noise.
        descent: settings of a gradient descent; None: Gauss-Newton steps.
    """

    scene: Scene
    parameters: tuple[Parameter, ...]
    simulator: Simulator
    windows: Windows
    starts: Starts
    lyapunov: float
    started: float
    compiled_before: float
    noise: Noise | None = None
    known: JointPrior = JointPrior()
    begin: np.ndarray | None = None
    left_out: tuple[Span, ...] = ()
    outliers: tuple[str, ...] = ()
    breaks: tuple[tuple[int, float], ...] = ()
    iterations: int = 0
    first_noise: Noise | None = None
    descent: Descent | None = None

    def problem(self, loss: Loss = LEAST_SQUARES, frozen: np.ndarray | None = None) -> Problem:
        """The minimisation problem."""
        return Problem(
            simulator=self.simulator,
            windows=self.first_windows,
            parameters=self.parameters,
            loss=loss,
            frozen=frozen,
            noise=self.noise or self.first_noise,
            known=self.known,
            rest=self.rest,
            descent=self.descent,
        )

    @property
    def first_windows(self) -> Windows:
        """The windows with the noise that a fit starts with."""
        if self.noise is not None or self.first_noise is None:
            return self.windows
        return self.first_noise.apply_to(self.windows, self.traces)

    def claimed_windows(self, point: Solution) -> Windows:
        """The windows with the noise that the traces claim, and a solution's steps."""
        return replace(self.windows, substeps=point.windows.substeps)

    def with_noise(self, noise: Noise | None) -> Prepared:
        """The preparation with the noise estimated by a fit, if any: in the windows and in all that are cut later."""
        if noise is None:
            return self
        return replace(self, windows=noise.apply_to(self.windows, self.traces), noise=noise)

    def with_noise_of(self, problem: Problem) -> Prepared:
        """The preparation with the noise of a fit's problem, which also weighs the poses at rest."""
        return replace(self.with_noise(problem.noise), rest=problem.rest)

    def cut(self, length: float, pieces: Sequence[Span]) -> Windows:
        """Windows of `length` [s] of these (run, from, to), of the same substeps and noise."""
        return self._as_fitted(cut(self.traces, length, self.windows.dt, self.sigma, pieces))

    def _as_fitted(self, windows: Windows) -> Windows:
        """Windows with the substeps and the noise of the fitted ones."""
        windows = replace(windows, substeps=self.windows.substeps)
        if self.noise is None:
            return windows
        return self.noise.apply_to(windows, self.traces)

    def with_pieces(self, pieces: Sequence[Piece]) -> Prepared:
        """The preparation cut into other windows, with the known noise, and with starts from the samples."""
        windows = fill(self.traces, pieces, self.windows.dt, self.sigma)
        if self.simulator.release is not None:
            windows = self.simulator.release.mark(windows, self.traces)
        other = replace(self, windows=self._as_fitted(windows))
        return replace(other, starts=other.starts_from_samples())

    def with_parameters(
        self, parameters: Sequence[Parameter], begin: np.ndarray, simulator: Simulator | None = None
    ) -> Prepared:
        """The preparation with other free parameters, from values (k,); the simulator's programs must know them."""
        simulator = simulator or self.simulator
        every, known = rig_priors(self.scene, simulator.model, parameters)
        return replace(self, parameters=every, known=known, simulator=simulator.view_of(every), begin=begin)

    def starting_at(self, solution: Solution) -> Prepared:
        """The preparation, started from the end of a fit."""
        return replace(self, begin=solution.values, starts=solution.starts)

    def starts_from_samples(self) -> Starts:
        """Starts of the windows from their samples alone."""
        return first_starts(self.simulator.model, self.traces, self.windows, self.sigma)

    @property
    def floor(self) -> np.ndarray:
        """Minimum noise of every run and link relative to the claimed one (R, n): the sensor's rounding."""
        fit = self.scene.fit
        rounding = 0.0
        if fit is not None:
            rounding = fit.resolution("angle") / np.sqrt(12)
        claimed = []
        for sigma, trace in zip(self.sigma, self.traces, strict=True):
            if trace.se is not None:  # perhaps not of every link
                stated = np.where(np.isfinite(trace.se).any(axis=0), trace.se, sigma)
                sigma = np.sqrt(np.nanmean(stated**2, axis=0))
            claimed.append(sigma)
        return np.maximum(rounding / np.array(claimed), 1e-9)

    @property
    def names(self) -> list[str]:
        """Names of the free parameters."""
        return [p.name for p in self.parameters]

    @property
    def order(self) -> int:
        """Order of the scheme for which the windows' step was chosen."""
        return self.simulator.stepper.integrator.order

    @property
    def values(self) -> np.ndarray:
        """Start of the parameters (k,): their start values, or the end of an earlier fit."""
        if self.begin is not None:
            return self.begin
        return np.array([p.value for p in self.parameters])


def program_space(traces: Sequence[Trace], length: float, dt: float) -> tuple[int, int]:
    """Steps and sample slots of windows of this length [s]."""
    return int(length / dt + 1e-6), int(length / min(trace.interval for trace in traces) + 1.5)
