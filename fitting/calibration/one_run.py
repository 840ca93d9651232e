"""Checks of a fit: one uninterrupted run compared with the trace, and the energy that the motion loses.

A fit explains a trace window by window. Readers expect one run, from one start to the end of the trace. Where the
motion is chaotic, such a run must leave the trace in the end even with correct parameters. A second run, started one
standard error away in the start and in every parameter, shows when. Until the two runs diverge, the run is a
prediction; afterwards its angles carry no information, but its statistics do.

An independent check of a fit: does the measured motion lose energy as fast as the fitted law predicts?

Nothing is simulated. With angles and rates from the smoothed traces, E the energy and P the power that the law
dissipates,

    E(t) = E0 - c W(t) + noise,     W(t) = integral of P

is a straight line in W, with slope c = 1 if the law is right. Noise of the rates adds a mean contribution to both, and
this is subtracted (`balance.without_noise`): without this, 4 mrad at 60 Hz made slopes 0.5 % too small. Each run has
its own E0; E and W are means over stretches of time. The error of the slope combines the scatter of blocks of stretches
(a jackknife) with the errors of the fitted parameters, by differences.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from fitting.calibration.decision import smooth_stretch, smoothed_noise, without_noise
from fitting.calibration.result import EnergyCheck, FitResult
from fitting.estimate.marching import march
from fitting.parameters.of_scene import DAMPING
from fitting.parameters.parameter import apply
from fitting.parameters.target import camera_angles, clock_rate, losses
from fitting.traces import planar

#: Number of stretches of time over which a run is averaged, and of blocks of them.
STRETCHES, BLOCKS = 60, 10


def check_energy(result: FitResult) -> EnergyCheck | None:
    """The check, computed once and stored in the result with its warning."""
    if result.energy is None:
        result.energy = energy_check(result)
        if result.energy is not None and result.energy.warning:
            result.warnings.append(result.energy.warning)
    return result.energy


def energy_check(result: FitResult) -> EnergyCheck | None:
    """The common slope of all runs; None if the law takes no energy or the motion does not determine it."""
    simulator, parameters = result.solution.problem.simulator, result.parameters
    model = simulator.model
    if simulator.release is not None or not any(e.name in DAMPING for e in model.effects):
        return None
    # half width of the smoother as a fraction of the shortest link's period: its cubics lose 1e-4 of a swing's energy
    reach = 0.06 * 2 * np.pi * np.sqrt(float(np.min(np.asarray(model.line.length))) / 9.81)
    runs = [(i, smooth_stretch(trace, _covered_span(result, i), reach)) for i, trace in enumerate(result.traces)]
    runs = [(*run, *_noise(result, i, run[2], reach)) for i, run in runs if run is not None]

    @jax.jit
    def energies_at(
        values: jax.Array, theta: jax.Array, omega: jax.Array, *noise: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        at = apply(model, parameters, values)
        rate = clock_rate(parameters, values)
        omega = omega if rate is None else omega / rate
        # the camera's correction is the same at the measured and at the true angles, except for its square
        theta = theta - (camera_angles(at, parameters, values, theta) - theta)
        return jax.vmap(lambda a, w: without_noise(at, a, w, *noise))(theta, omega)

    def find_stretches(values: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        clock = clock_rate(parameters, values) or 1.0
        return [_stretches(clock * t, *map(np.asarray, energies_at(jnp.asarray(values), *rest))) for t, *rest in runs]

    rows = find_stretches(result.values)
    if not sum(np.ptp(w) for _, w in rows) > 0:
        return None
    slope = _slope(rows, None)
    parts = np.array([_slope(rows, b) for b in range(BLOCKS)])
    square = (BLOCKS - 1) / BLOCKS * float(np.sum((parts - parts.mean()) ** 2))
    step = np.zeros(len(result.values))
    for i in np.flatnonzero(result.uncertainty.std_error > 0):
        moved, size = np.array(result.values), 0.1 * result.uncertainty.std_error[i]
        moved[i] += size
        step[i] = (_slope(find_stretches(moved), None) - slope) / size
    square += float(step @ result.uncertainty.covariance @ step)
    return EnergyCheck(slope, float(np.sqrt(max(square, 1e-300))))


def _noise(result: FitResult, run: int, omega: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations (n,) of a run's smoothed angles [rad] and rates [rad/s]."""
    none = np.zeros((len(result.traces), omega.shape[1]))
    table = {"delay_s": none, "kept": none} | result.noise_table()
    late = table["delay_s"][run] * np.sqrt(np.mean(omega**2, axis=0))
    gains = np.array([smoothed_noise(result.traces[run], reach, float(k)) for k in table["kept"][run]])
    return tuple((np.hypot(table["sigma_rad"][run], late)[:, None] * gains).T)


def _covered_span(result: FitResult, run: int) -> tuple[float, float]:
    """Start and end of the windows of a run that follow each other without a gap, from the first one on."""
    windows = result.windows
    mine = np.flatnonzero(windows.run == run)
    if not len(mine):
        return 0.0, 0.0
    apart = [*(np.flatnonzero(~windows.follows[mine[1:]]) + 1), len(mine)]
    return float(windows.begin[mine[0]]), float(windows.ends[mine[apart[0] - 1]])


def _stretches(t: np.ndarray, energy: np.ndarray, power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means (STRETCHES,) of the energy and of the energy dissipated so far by the law [J]."""
    taken = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(t))])
    parts = np.array_split(np.arange(len(t)), STRETCHES)
    return np.array([energy[p].mean() for p in parts]), np.array([taken[p].mean() for p in parts])


def _slope(rows: list[tuple[np.ndarray, np.ndarray]], without: int | None) -> float:
    """Negative slope of the energy over the dissipated energy; also with each block of stretches left out."""
    keep = np.ones(STRETCHES, bool)
    if without is not None:
        keep[without * (STRETCHES // BLOCKS) : (without + 1) * (STRETCHES // BLOCKS)] = False
    both = [(e[keep] - e[keep].mean(), w[keep] - w[keep].mean()) for e, w in rows]
    return -float(sum(e @ w for e, w in both) / sum(w @ w for _, w in both))


#: RMS over the links [rad] at which two motions count as diverged.
PARTED = 0.1


@dataclass(frozen=True)
class OneRun:
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
        return float(self.t[0])

    @property
    def text(self) -> str:
        """For people."""
        whole = f"all {self.t[-1] - self.begin:.3g} s"
        after = [f"{at - self.begin:.3g} s" if np.isfinite(at) else whole for at in (self.diverged_at, self.trusted)]
        return (
            f"one run from the start at {self.begin:.3g} s stays within {PARTED:g} rad of the trace for {after[0]}; "
            f"a run that starts one standard error away stays with it for {after[1]}"
        )


def one_run(result: FitResult, run: int) -> OneRun | None:
    """The run for trace `run`; None if no window of it has a start of its own, or if it would take too long."""
    windows, solution = result.windows, result.solution
    mine = np.flatnonzero((windows.run == run) & ~windows.released)
    if not len(mine):
        return None
    first = mine[np.argmin(windows.begin[mine])]
    trace, begin = result.traces[run], float(windows.begin[first])
    # the clock changes at lost frames
    lost = (result.parameters[i].where for i in losses(result.parameters))
    end = min([trace.t[-1], *(frame.time for frame in lost if frame.run == run)])
    inside = (trace.t >= begin - 1e-9) & (trace.t <= end + 1e-9)
    t = trace.t[inside]
    steps = int(np.ceil((t[-1] - begin) / windows.dt + 1e-9)) if len(t) > 1 else 0
    # maximum number of steps of a run
    if not 0 < steps * windows.substeps <= 200_000:
        return None
    values, n = np.asarray(result.values, float), windows.theta.shape[2]
    theta, omega = np.split(solution.evaluation.start[first], 2)
    samples = max(float((windows.weight[first] > 0).sum()) / n, 1.0)
    aside = result.noise / np.sqrt(samples) * np.sign(np.sin(1.0 + np.arange(n)))
    error = np.where(np.isfinite(result.uncertainty.std_error), result.uncertainty.std_error, 0.0)
    low, high = solution.problem.bounds(values)
    starts = np.stack([theta, theta + aside]), np.stack([omega, omega])
    at = np.arange(steps + 1) * windows.dt + begin
    angles = _runs(result, np.stack([values, np.clip(values + error, low, high)]), *starts, steps)
    from scipy.interpolate import CubicHermiteSpline  # noqa: PLC0415 - slow to import, and only a report needs it

    near, other = (CubicHermiteSpline(at, *pair)(t) for pair in angles)
    measured = trace.theta[inside]
    return OneRun(t, measured, near, _parting(t, other - near), _parting(t, measured - near))


def _runs(
    result: FitResult, values: np.ndarray, theta: np.ndarray, omega: np.ndarray, steps: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Observed angles and rates on the trace's clock (steps + 1, n), of runs at values (2, k) and starts (2, n)."""
    simulator, windows = result.solution.problem.simulator, result.windows
    parameters, base = result.parameters, simulator.model

    @jax.jit
    def run(values: jax.Array, theta: jax.Array, omega: jax.Array) -> tuple[jax.Array, jax.Array]:
        model = apply(base, parameters, values)
        rate = clock_rate(parameters, values)
        h = windows.dt if rate is None else windows.dt * rate
        start = planar.close_chain(model, theta, omega)
        state = planar.to_state(model, *start)
        moved = march(simulator.stepper, model, state, h, steps, jnp.int32(windows.substeps), steps, steps)
        angles, rates = (jnp.concatenate([a[None], b]) for a, b in zip(start, moved[:2], strict=True))
        look = lambda angles: camera_angles(model, parameters, values, angles)  # noqa: E731
        return jax.jvp(look, (angles,), (rates * (1.0 if rate is None else rate),))

    found = [run(*map(jnp.asarray, one)) for one in zip(values, theta, omega, strict=True)]
    return [(np.unwrap(np.asarray(a), axis=0), np.asarray(b)) for a, b in found]


def _parting(t: np.ndarray, difference: np.ndarray) -> float:
    """First time [s] from which differences (m, n) [rad], as shortest turns, permanently have an RMS above `PARTED`.

    The RMS is averaged over 0.05 s to either side, so that a single wrong sample does not count.
    """
    difference = difference - 2 * np.pi * np.round(np.nan_to_num(difference) / (2 * np.pi))
    width = max(1, round(0.1 / max(float(np.median(np.diff(t))), 1e-9)))
    smooth = lambda x: np.convolve(x.sum(axis=1), np.ones(width), "same")  # noqa: E731
    known = np.isfinite(difference)
    rms = np.sqrt(smooth(np.where(known, difference, 0.0) ** 2) / np.maximum(smooth(known), 1))
    beyond = np.flatnonzero(rms > PARTED)
    return float(t[beyond[0]]) if len(beyond) else np.inf
