"""A check of a fit: one uninterrupted run compared with the trace.

A fit explains a trace window by window. Readers expect one run, from one start to the end of the trace. Where the
motion is chaotic, such a run must leave the trace in the end even with correct parameters. A second run, started one
standard error away in the start and in every parameter, shows when. Until the two runs diverge, the run is a
prediction; afterwards its angles carry no information, but its statistics do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from fitting.calibration.result import FitResult
from fitting.estimate.window_run import Start, march
from fitting.parameters.forward_derivatives import differentiate
from fitting.parameters.observation import camera_angles, clock_rate, lost_frames
from fitting.parameters.parameter import with_parameter_values
from fitting.traces import planar

#: RMS over the links [rad] at which two motions count as diverged.
DIVERGED_ANGLE = 0.1


@dataclass(frozen=True)
class Prediction:
    """A run of the fitted model from the first window's start to the end of its trace.

    Attributes:
        t, measured, simulated: the trace's samples (m,) [s], (m, n) [rad], NaN if missing; as seen by the camera.
        trusted: time [s] at which a run that starts one standard error away has diverged from it; infinite: never.
        diverged_at: time [s] at which the measured angles have diverged; infinite: never.
    """

    t: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    trusted: float
    diverged_at: float

    @property
    def begin(self) -> float:
        """Time of its start [s]."""
        return self.t[0]

    @property
    def text(self) -> str:
        """For people."""
        return (
            f"one run from the start at {self.begin:.3g} s stays within {DIVERGED_ANGLE:g} rad of the trace for "
            f"{self._until(self.diverged_at)}; a run that starts one standard error away stays with it for "
            f"{self._until(self.trusted)}"
        )

    def _until(self, t: float) -> str:
        """Duration of the run up to a time [s], in words."""
        if np.isfinite(t):
            return f"{t - self.begin:.3g} s"
        return f"all {self.t[-1] - self.begin:.3g} s"


#: Maximum number of steps of a run.
MOST_STEPS = 200_000


def predict(result: FitResult, run: int = 0) -> Prediction | None:
    """The run for trace `run`; None if no window of it has its own start, or if the run fails or is too long."""
    windows = result.windows
    mine = np.flatnonzero((windows.run == run) & ~windows.released)
    if not len(mine):
        return None
    first = mine[np.argmin(windows.begin[mine])]
    trace = result.traces[run]
    begin = windows.begin[first]
    end = trace.t[-1]
    for lost in lost_frames(result.parameters).values():  # the clock changes there
        if lost.run == run and lost.time > begin:
            end = min(end, lost.time)
    inside = (trace.t >= begin - 1e-9) & (trace.t <= end + 1e-9)
    t = trace.t[inside]
    steps = 0
    if len(t) > 1:
        steps = int(np.ceil((t[-1] - begin) / windows.dt + 1e-9))
    if not 0 < steps * windows.substeps <= MOST_STEPS:
        return None
    simulate = _simulator_of(result, steps)
    at = np.arange(steps + 1) * windows.dt + begin
    theta, omega = np.split(result.solution.evaluation.start[first], 2)
    near = _at_times(t, at, simulate(result.values, theta, omega))
    # where the run of the fit has no motion, as after a step that did not solve, there is nothing to compare
    runs = np.all(np.isfinite(near), axis=1)
    if not runs[0]:
        return None
    t = t[runs]
    near = near[runs]
    other = _at_times(t, at, simulate(_values_aside(result), theta + _angles_aside(result, first), omega))
    measured = trace.theta[inside][runs]
    trusted = min(_parting(t, other - near), _first_missing(t, other))
    return Prediction(t, measured, near, trusted, _parting(t, measured - near))


def _values_aside(result: FitResult) -> np.ndarray:
    """Every parameter one standard error away (k,), inside its bounds."""
    error = np.where(np.isfinite(result.uncertainty.std_error), result.uncertainty.std_error, 0.0)
    return np.clip(result.values + error, *result.solution.problem.bounds(result.values))


def _angles_aside(result: FitResult, window: int) -> np.ndarray:
    """One standard error (n,) [rad] of a window's first angles, with signs that differ between links."""
    weight = result.windows.weight[window]
    links = result.solution.evaluation.start.shape[1] // 2
    samples = max((weight > 0).sum() / links, 1.0)
    return result.noise / np.sqrt(samples) * np.sign(np.sin(1.0 + np.arange(links)))


def _simulator_of(result: FitResult, steps: int) -> Callable[..., tuple[Array, Array]]:
    """A run of the fit's model: observed angles and rates (steps + 1, n) on the trace's clock, from values (k,) and a
    start (n,)."""
    simulator = result.solution.problem.simulator
    windows = result.windows
    parameters = result.parameters
    base = simulator.model

    @jax.jit
    def run(values: Array, theta: Array, omega: Array) -> tuple[Array, Array]:
        model = with_parameter_values(base, parameters, values)
        rate = clock_rate(parameters, values)
        if rate is None:
            rate = jnp.ones(())
        theta, omega = planar.close_chain(model, theta, omega)
        state = planar.to_state(model, theta, omega)
        whole = jnp.arange(steps), jnp.zeros(steps)
        start = Start(theta, omega, state, jnp.asarray(windows.dt * rate, theta.dtype), whole)
        none = jnp.zeros((0, len(values)))
        first = differentiate(lambda _: start, values, none)
        moved, _ = march(simulator.stepper, lambda _: model, values, none, first, steps, windows.substeps, steps, steps)
        angles, rates = jax.vmap(partial(planar.from_nodes, model))(*moved.tree)
        angles = jnp.concatenate([theta[None], angles])
        rates = jnp.concatenate([omega[None], rates])

        def observe(angles: Array) -> Array:
            return camera_angles(model, parameters, values, angles)

        return jax.jvp(observe, (angles,), (rates * rate,))

    return run


def _at_times(t: np.ndarray, at: np.ndarray, motion: tuple[Array, Array]) -> np.ndarray:
    """Angles at times t of a motion with angles and rates at times `at`; NaN from where it is not finite."""
    from scipy.interpolate import CubicHermiteSpline  # noqa: PLC0415 - slow to import, and only a report needs it

    angles, rates = (np.asarray(part) for part in motion)
    finite = np.isfinite(angles).all(axis=1) & np.isfinite(rates).all(axis=1)
    count = np.logical_and.accumulate(finite).sum()
    found = np.full((len(t), angles.shape[1]), np.nan)
    if count > 1:
        before = t <= at[count - 1] + 1e-9
        spline = CubicHermiteSpline(at[:count], np.unwrap(angles[:count], axis=0), rates[:count])
        found[before] = spline(t[before])
    return found


def _first_missing(t: np.ndarray, angles: np.ndarray) -> float:
    """First time [s] at which angles (m, n) are not finite; infinite without any."""
    missing = np.flatnonzero(~np.isfinite(angles).all(axis=1))
    if len(missing):
        return t[missing[0]]
    return np.inf


#: Length of time [s] over which differences of two motions are averaged.
AVERAGED_TIME = 0.1


def _parting(t: np.ndarray, difference: np.ndarray) -> float:
    """First time [s] at which the RMS of differences (m, n) [rad] exceeds `DIVERGED_ANGLE`; otherwise infinite.

    Differences count as shortest turns. The mean square is averaged over 0.05 s to either side, so that a single wrong
    sample does not count.
    """
    difference = difference - 2 * np.pi * np.round(np.nan_to_num(difference) / (2 * np.pi))
    width = max(1, round(AVERAGED_TIME / max(np.median(np.diff(t)), 1e-9)))
    known = np.isfinite(difference)
    square = np.sum(np.where(known, difference, 0.0) ** 2, axis=1)
    square = np.convolve(square, np.ones(width), "same")
    count = np.convolve(known.sum(axis=1), np.ones(width), "same")
    rms = np.sqrt(square / np.maximum(count, 1))
    beyond = np.flatnonzero(rms > DIVERGED_ANGLE)
    if len(beyond):
        return t[beyond[0]]
    return np.inf
