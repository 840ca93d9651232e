"""An independent look at a fit: does the measured motion lose its energy as fast as the fitted law says?

Nothing is simulated. With angles and rates from the smoothed traces, E the energy and P the power that the law takes,

    E(t) = E0 - c W(t) + noise,     W(t) = integral of P

is a straight line in W, whose slope c is 1 where the law is right. Each run has its own E0; E and W are means over
stretches of time, the slope's error is the scatter of blocks of them (a jackknife), together with the fitted
parameters' own, by differences.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import savgol_filter

from dropper_jax.effects.joint_friction import JointFriction
from dropper_jax.model import Model
from dropper_jax.model.slots import Potential
from fitting.calibration.result import EnergyCheck, FitResult
from fitting.parameters.naming import DAMPING
from fitting.parameters.parameter import apply, camera_offset
from fitting.traces import planar
from fitting.traces.trace import Trace

#: Half width of the smoother, as a part of the shortest link's period: its cubics leave 1e-4 of a swing's energy.
SMOOTH = 0.06
#: Stretches of time into which a run is averaged, and blocks of them.
STRETCHES, BLOCKS = 60, 10


def look_at_energy(result: FitResult) -> EnergyCheck | None:
    """The check, found once, kept in the result with its warning."""
    if result.energy is None:
        result.energy = energy_check(result)
        if result.energy is not None and result.energy.warning:
            result.warnings.append(result.energy.warning)
    return result.energy


def energy_check(result: FitResult) -> EnergyCheck | None:
    """The slope of every run together; None where the law takes no energy, or nothing can be said of the motion."""
    simulator, parameters = result.solution.problem.simulator, result.parameters
    model = simulator.model
    taking = [e for e in model.effects if e.name in DAMPING]
    if not taking or result.solution.problem.simulator.release is not None:
        return None
    runs = [measured(trace, _seen(result, i), _reach(model)) for i, trace in enumerate(result.traces)]
    runs = [run for run in runs if run is not None]
    if not runs:
        return None

    @jax.jit
    def seen(values: jax.Array, theta: jax.Array, omega: jax.Array) -> tuple[jax.Array, jax.Array]:
        at = apply(model, parameters, values)
        shift = camera_offset(parameters, values, model.line.links)
        return jax.vmap(lambda a, w: balance(at, *planar.closed(at, a - shift, w)))(theta, omega)

    def found(values: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        return [_stretches(t, *map(np.asarray, seen(jnp.asarray(values), *angles))) for t, *angles in runs]

    rows = found(result.values)
    if not sum(np.ptp(w) for _, w in rows) > 0:
        return None
    slope = _slope(rows, None)
    left = np.array([_slope(rows, b) for b in range(BLOCKS)])
    square = (BLOCKS - 1) / BLOCKS * float(np.sum((left - left.mean()) ** 2))
    se, step = result.uncertainty.std_error, []
    for i, size in enumerate(se):
        moved = np.array(result.values)
        moved[i] += 0.1 * size
        step.append((_slope(found(moved), None) - slope) / (0.1 * size) if size > 0 else 0.0)
    square += float(np.array(step) @ result.uncertainty.covariance @ np.array(step))
    return EnergyCheck(slope, float(np.sqrt(max(square, 1e-300))))


def balance(model: Model, theta: jax.Array, omega: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Energy [J] of a pose with rates, and the power [W] that the damping takes from it."""
    s = planar.to_state(model, theta, omega)
    k = model.instant(s.r, s.v, s.t, model.ends(s.t))
    taken = jnp.zeros(())
    for effect in model.effects:
        if effect.name not in DAMPING or isinstance(effect, Potential):
            continue
        force = effect.force(k)
        if force is not None:
            taken = taken - jnp.sum(force * k.v)
        if isinstance(effect, JointFriction) and effect.dry is not None:
            rate = jnp.sum(jnp.abs(effect.relative_rates(k)), axis=1)
            taken = taken + jnp.sum(jnp.broadcast_to(effect.dry, (model.line.links + 1,))[: len(rate)] * rate)
    return model.kinetic_energy(k) + model.potential_energy(k), taken


def _reach(model: Model) -> float:
    return SMOOTH * 2 * np.pi * np.sqrt(float(np.min(model.line.length)) / 9.81)


def _seen(result: FitResult, run: int) -> tuple[float, float]:
    """From where to where windows of a run follow each other without a gap, from its first one on."""
    windows = result.windows
    mine = np.flatnonzero(windows.run == run)
    if not len(mine):
        return 0.0, 0.0
    end = mine[0] + 1
    while end < windows.count and windows.follows[end] and windows.run[end] == run:
        end += 1
    return float(windows.begin[mine[0]]), float(windows.begin[end - 1] + windows.length)


def measured(trace: Trace, span: tuple[float, float], reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Even times (k,) and smoothed angles and rates (k, n) of a stretch of a trace; None where it is too short."""
    part = trace.between(*span)
    if len(part.t) < 2 * STRETCHES:
        return None
    step = part.interval
    t = np.arange(part.t[0], part.t[-1] + 0.5 * step, step)
    width = 2 * max(2, round(reach / step)) + 1
    theta, omega = np.zeros((2, len(t), trace.links))
    for j, column in enumerate(part.theta.T):
        known = np.isfinite(column)
        even = np.interp(t, part.t[known], column[known])
        theta[:, j] = savgol_filter(even, width, 3)
        omega[:, j] = savgol_filter(even, width, 3, deriv=1, delta=step)
    return t, theta, omega


def _stretches(t: np.ndarray, energy: np.ndarray, power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means (STRETCHES,) of the energy and of what the law has taken so far [J]."""
    taken = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(t))])
    parts = np.array_split(np.arange(len(t)), STRETCHES)
    return np.array([energy[p].mean() for p in parts]), np.array([taken[p].mean() for p in parts])


def _slope(rows: list[tuple[np.ndarray, np.ndarray]], without: int | None) -> float:
    """Slope of the energy over what the law takes, its sign turned; with a block of stretches left out."""
    keep = np.ones(STRETCHES, bool)
    if without is not None:
        keep[without * (STRETCHES // BLOCKS) : (without + 1) * (STRETCHES // BLOCKS)] = False
    both = [(e[keep] - e[keep].mean(), w[keep] - w[keep].mean()) for e, w in rows]
    return -float(sum(e @ w for e, w in both) / sum(w @ w for _, w in both))
