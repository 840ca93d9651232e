"""The input of an estimate, and the stretches of time that it does not use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.noise import Noise
from fitting.estimate.problem import Descent, Problem, Solution
from fitting.estimate.rest import Rest
from fitting.estimate.simulator import Simulator
from fitting.estimate.windows import Piece, Starts, Windows, cut, fill, first_starts
from fitting.parameters.of_scene import JointPrior, rig_priors
from fitting.parameters.parameter import Parameter
from fitting.parameters.target import LostPlace
from fitting.traces.trace import Trace


def at_frames(parameters: Sequence[Parameter], traces: Sequence[Trace]) -> tuple[Parameter, ...]:
    """The parameters with the times of the frames that they refer to.

    Raises:
        SceneError: an unknown run, or a frame without a predecessor.
    """
    found = list(parameters)
    for i, p in enumerate(found):
        if isinstance(p.where, LostPlace):
            if p.where.run >= len(traces):
                raise SceneError(f"free: {p.name!r}: unknown run; allowed: 0 to {len(traces) - 1}")
            t = traces[p.where.run].t
            if not 0 < p.where.frame < len(t):
                raise SceneError(f"free: {p.name!r}: unknown frame; allowed: 1 to {len(t) - 1}")
            found[i] = replace(p, where=replace(p.where, time=float(t[p.where.frame])))
    return tuple(found)


def fitted_parts(traces: Sequence[Trace], spans: Sequence[tuple[int, float, float]]) -> list[Trace]:
    """The traces with every sample outside the spans (run, from, to) [s] marked as missing."""
    found = []
    for i, trace in enumerate(traces):
        inside = np.zeros(len(trace.t), bool)
        for run, low, high in spans:
            inside |= (run == i) & (trace.t >= low - 1e-9) & (trace.t < high - 1e-9)
        found.append(replace(trace, theta=np.where(inside[:, None], trace.theta, np.nan)))
    return found


#: Steps per period of the shortest link as a pendulum, by the scheme's order: 1/120 s for the lab dropper (error after
#: 1 s 1.6e-5 rad) at order 4; second order takes more; a fit that needs finer steps halves it.
#: Schemes with error control save at least this often, for the cubics between.
STEPS_PER_PERIOD = {8: 38, 5: 38, 4: 75, 2: 200}


@dataclass(frozen=True)
class Prepared:
    """Everything that an estimator needs: the result of `prepare`.

    Attributes:
        left_out: (run, from, to) of windows that are not fitted because no start explains them.
        breaks: (run, time) where the motion jumps, so that windows are not joined there.
        iterations: evaluations used so far.
        first_noise: noise at the start of a fit, if links are missed by different multiples of their claimed noise.
    """

    scene: Scene
    traces: list[Trace]
    sigma: list[np.ndarray]
    parameters: tuple[Parameter, ...]
    simulator: Simulator
    windows: Windows
    starts: Starts
    held_out: tuple[tuple[float, float], ...]
    lyapunov: float
    period: float
    warnings: tuple[str, ...]
    started: float = 0.0
    compiled_before: float = 0.0
    noise: Noise | None = None
    known: JointPrior = JointPrior()
    rest: Rest | None = None
    begin: np.ndarray | None = None
    left_out: tuple[tuple[int, float, float], ...] = ()
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

    def noisy(self, noise: Noise | None) -> Prepared:
        """The preparation with the noise estimated by a fit, if any: in the windows and in all that are cut later."""
        return self if noise is None else replace(self, windows=noise.apply_to(self.windows, self.traces), noise=noise)

    def cut(self, length: float, pieces: Sequence[tuple[int, float, float]]) -> Windows:
        """Windows of `length` [s] of these (run, from, to), of the same substeps and noise."""
        return self._as_fitted(cut(self.traces, length, self.windows.dt, self.sigma, pieces))

    def _as_fitted(self, windows: Windows) -> Windows:
        windows = replace(windows, substeps=self.windows.substeps)
        return windows if self.noise is None else self.noise.apply_to(windows, self.traces)

    def with_pieces(self, pieces: Sequence[Piece]) -> Prepared:
        """The preparation cut into other windows, with the known noise, and with starts from the samples."""
        windows = fill(self.traces, pieces, self.windows.dt, self.sigma)
        if self.simulator.release is not None:
            windows = self.simulator.release.mark(windows, self.traces)
        found = replace(self, windows=self._as_fitted(windows))
        return replace(found, starts=found.starts_from_samples())

    def with_parameters(
        self, parameters: Sequence[Parameter], begin: np.ndarray, simulator: Simulator | None = None
    ) -> Prepared:
        """The preparation with other free parameters, from values (k,); the simulator's programs must know them."""
        simulator = simulator or self.simulator
        every, known = rig_priors(self.scene, simulator.model, parameters)
        return replace(self, parameters=every, known=known, simulator=simulator.view_of(every), begin=begin)

    def starts_from_samples(self) -> Starts:
        """Starts of the windows from their samples alone."""
        return first_starts(self.simulator.model, self.traces, self.windows, self.sigma)

    @property
    def floor(self) -> np.ndarray:
        """Minimum noise of every run and link relative to the claimed one (R, n): the sensor's rounding."""
        fit = self.scene.fit
        rounding = 0.0 if fit is None else fit.resolution("angle") / np.sqrt(12)
        claimed = [
            s if trace.se is None else np.sqrt(np.nanmean(trace.se**2, axis=0))
            for s, trace in zip(self.sigma, self.traces, strict=True)
        ]
        return np.maximum(rounding / np.array(claimed), 1e-9)

    @property
    def order(self) -> int:
        """Order of the scheme for which the windows' step was chosen."""
        return self.simulator.stepper.integrator.order

    @property
    def values(self) -> np.ndarray:
        """Start of the parameters (k,): their start values, or the end of an earlier fit."""
        return self.begin if self.begin is not None else np.array([p.value for p in self.parameters])
