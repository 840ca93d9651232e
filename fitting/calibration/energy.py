"""An independent check of a fit: does the measured motion lose energy as fast as the fitted law predicts?

Nothing is simulated. With angles and rates from the smoothed traces, E the energy and P the power that the law
dissipates,

    E(t) = E0 - c W(t) + noise,     W(t) = integral of P

is a straight line in W, with slope c = 1 if the law is right. Noise of the rates adds a mean contribution to both, and
this is subtracted (`balance.without_noise`): without this, 4 mrad at 60 Hz made slopes 0.5 % too small. Each run has
its own E0; E and W are means over stretches of time. The error of the slope combines the scatter of blocks of stretches
(a jackknife) with the errors of the fitted parameters, by differences.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.model import Model
from fitting.calibration.balance import smooth_stretch, smoothed_noise, without_noise
from fitting.calibration.result import EnergyCheck, FitResult
from fitting.parameters.of_scene import DAMPING
from fitting.parameters.parameter import apply
from fitting.parameters.target import camera_angles, clock_rate

#: Half width of the smoother as a fraction of the shortest link's period: its cubics lose 1e-4 of a swing's energy.
SMOOTH = 0.06
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
    taking = [e for e in model.effects if e.name in DAMPING]
    if not taking or result.solution.problem.simulator.release is not None:
        return None
    reach = _reach(model)
    runs = [(i, smooth_stretch(trace, _covered_span(result, i), reach)) for i, trace in enumerate(result.traces)]
    runs = [(*run, *_noise(result, i, run[2], reach)) for i, run in runs if run is not None]
    if not runs:
        return None

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
    se, step = result.uncertainty.std_error, []
    for i, size in enumerate(se):
        moved = np.array(result.values)
        moved[i] += 0.1 * size
        step.append((_slope(find_stretches(moved), None) - slope) / (0.1 * size) if size > 0 else 0.0)
    square += float(np.array(step) @ result.uncertainty.covariance @ np.array(step))
    return EnergyCheck(slope, float(np.sqrt(max(square, 1e-300))))


def _noise(result: FitResult, run: int, omega: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations (n,) of a run's smoothed angles [rad] and rates [rad/s]."""
    table = result.noise_table()
    size, links = table["sigma_rad"][run], omega.shape[1]
    late = table["delay_s"][run] * np.sqrt(np.mean(omega**2, axis=0)) if "delay_s" in table else np.zeros(links)
    kept = table["kept"][run] if "kept" in table else np.zeros(links)
    gains = np.array([smoothed_noise(result.traces[run], reach, float(k)) for k in kept])
    return tuple((np.hypot(size, late)[:, None] * gains).T)


def _reach(model: Model) -> float:
    return SMOOTH * 2 * np.pi * np.sqrt(float(np.min(np.asarray(model.line.length))) / 9.81)


def _covered_span(result: FitResult, run: int) -> tuple[float, float]:
    """Start and end of the windows of a run that follow each other without a gap, from the first one on."""
    windows = result.windows
    mine = np.flatnonzero(windows.run == run)
    if not len(mine):
        return 0.0, 0.0
    end = mine[0] + 1
    while end < windows.count and windows.follows[end] and windows.run[end] == run:
        end += 1
    return float(windows.begin[mine[0]]), float(windows.ends[end - 1])


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
