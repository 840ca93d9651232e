"""A reference motion, and an estimate of its own error from a second run by another scheme."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.integrators.consistent_velocities import solve_instant
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.stepping.stepper import make_stepper
from dropper_jax.study.counted_work import evaluation_work, step_work
from dropper_jax.study.lyapunov import perturbation_size, unit_perturbation
from dropper_jax.study.march import GridRun, Rows, grid_run, link_vectors, rms_angle


@dataclass(frozen=True)
class Reference:
    """A motion on a time grid, k times, the start not included.

    Attributes:
        t: (k,) [s].
        r: free nodes (k, nodes, 3) [m]; links: (k, n, 3) [m].
        tension: (k, n) [N] at those times.
        error: RMS angle between the links of the two runs [rad].
        made_by, checked_by: the two schemes, with their steps.
        independent: whether these are two different schemes.
        exponent: mean growth rate of perturbations [1/s].
        horizon, grid: span and spacing of the times [s].
    """

    t: np.ndarray
    r: np.ndarray
    links: np.ndarray
    tension: np.ndarray
    error: float
    made_by: str
    checked_by: str
    independent: bool
    exponent: float
    horizon: float
    grid: float

    def summary(self) -> dict[str, object]:
        return {
            "error_estimate_rad": self.error,
            "horizon_s": self.horizon,
            "grid_s": self.grid,
            "lyapunov_per_s": self.exponent,
            "made_by": self.made_by,
            "checked_by": self.checked_by,
            "independent": self.independent,
        }


def trusted_span(model: Model, s: State, duration: float, dt: float, grid: float) -> tuple[float, float]:
    """Time [s] before chaos amplifies rounding, and the mean growth rate of perturbations [1/s].

    From two runs that start 1e-8 apart, compared on the grid. They use the program that measures errors afterwards;
    the exact tangent map (`lyapunov`) would be another program to compile.
    """
    # size of the perturbation [-]: far above rounding, and still small after growth by a factor of 100
    nearby = 1e-8
    stepper = make_stepper(model)
    every = max(1, round(grid / dt))
    saves = max(2, int(duration / grid))
    start = replace(s, v=s.v + nearby * unit_perturbation(model, s))
    here = grid_run(stepper, model, s, grid, every, saves).rows
    there = grid_run(stepper, model, start, grid, every, saves).rows
    growth = np.log(np.asarray(_sizes(model, there.r - here.r, there.v - here.v)) / nearby)
    # growth of a perturbation up to which errors characterise the scheme: rounding (1e-16 per step) then stays below
    # 1e-12 rad, and an error of 0.01 rad is still far from saturation
    apart = np.flatnonzero(~np.isfinite(growth) | (growth > np.log(100.0)) | (here.bad >= 0))
    last = int(apart[0]) if apart.size else saves - 1
    span = min((last + 1) * grid, duration)
    return span, growth[last] / span


#: Maximum number of steps of one reference run, and maximum counted operations of a refinement: long runs in waves are
#: expensive.
MAX_STEPS = 150_000
MAX_WORK = 1e11
#: One run of the first scheme, and those of the second with the step, its half and its quarter.
RUNS_OF_SECOND = 7
#: Target error of the reference [rad]: 1e-4 of the minimum target error of the advice.
TARGET_ERROR = 1e-9
#: Steps per second of the first, coarsest run.
FIRST_STEPS_PER_SECOND = 256
#: Share of the error that half the step must at most leave: more is rounding or a kink in the forces, which refinement
#: does not reduce.
USEFUL_SHARE = 0.7


def reference(model: Model, s: State, grid: float, saves: int, exponent: float) -> Reference:
    """Refine two schemes together until they agree to `TARGET_ERROR` [rad], or neither can be refined further.

    The first is the fourth-order composition, the second RATTLE extrapolated to step zero (Romberg, three steps; its
    error has even powers only, so sixth order remains). Elastic lines use rk4 and rk2. If a scheme cannot run the
    model, `energy_momentum` replaces it, and `independent` is false.
    """
    names = ("energy_momentum_4", "rattle")
    if model.line.axial.elastic:
        names = ("rk4", "rk2")
    first, second = (_stepper_or_default(model, name) for name in names)
    evaluation = evaluation_work(model, s)
    per_step = step_work(model, first, evaluation) + RUNS_OF_SECOND * step_work(model, second, evaluation)
    every = max(4, int(np.ceil(grid * FIRST_STEPS_PER_SECOND)))

    def refined(every: int) -> _Refined:
        run = grid_run(first, model, s, grid, every, saves)
        check = _extrapolate(second, model, s, grid, every, saves)
        return _Refined(run, every, rms_angle(run.links, link_vectors(model, check, run.t)))

    best = refined(every)
    steps = 2 * every * saves
    while best.error > TARGET_ERROR and steps <= MAX_STEPS and steps * per_step <= MAX_WORK:
        finer = refined(steps // saves)
        if np.isfinite(finer.error) and finer.error > USEFUL_SHARE * best.error:
            break
        if finer.error < best.error:
            best = finer
        steps *= 2
    run = best.run
    if not np.isfinite(best.error):
        raise SceneError("accuracy: no reference was found: the fine runs fail. Try a shorter run")
    step = f"dt {grid / best.every:.4g} s"
    return Reference(
        t=run.t,
        r=run.r,
        links=run.links,
        tension=instant_tension(model, run.r, run.rows.v, run.t),
        error=best.error,
        made_by=f"{first.integrator.name}, {step}",
        checked_by=f"{second.integrator.name}, {step} and its half and quarter, extrapolated",
        independent=first.integrator.name != second.integrator.name,
        exponent=exponent,
        horizon=run.t[-1],
        grid=grid,
    )


class _Refined(NamedTuple):
    """A run of the first scheme, its steps per saved time, and its RMS angle [rad] to the second scheme."""

    run: GridRun
    every: int
    error: float


def _stepper_or_default(model: Model, name: str) -> Stepper:
    """The stepper of a scheme, or that of the default one if the scheme cannot run the model."""
    try:
        return make_stepper(model, name)  # work is counted, so that the compiled programs are the same as elsewhere
    except SceneError:
        return make_stepper(model, "energy_momentum")


def _extrapolate(stepper: Stepper, model: Model, s: State, grid: float, every: int, saves: int) -> np.ndarray:
    """Positions (k, nodes, 3) extrapolated from steps h, h/2, h/4, for an error in even powers of h."""
    h1, h2, h4 = (grid_run(stepper, model, s, grid, every * parts, saves).r for parts in (1, 2, 4))
    once = h2 + (h2 - h1) / 3
    again = h4 + (h4 - h2) / 3
    return again + (again - once) / 15


def instant_tension(model: Model, r: Rows, v: Rows, t: np.ndarray) -> np.ndarray:
    """Tensions (k, n) [N] of states r, v (k, nodes, 3) at times t (k,).

    Rigid links: the T for which no link's length accelerates, `d . d'' + |d'|^2 = 0` with `M a = F + G' T`;
    elastic ones: their law. NaN for models with set-valued laws, whose forces a state does not determine.
    """
    if model.laws:
        return np.full((len(t), model.line.links), np.nan)
    return np.asarray(_tensions(model, jnp.asarray(r), jnp.asarray(v), jnp.asarray(t, model.dtype)))


@cached_jit()
def _tensions(model: Model, r: Array, v: Array, t: Array) -> Array:
    def one(r: Array, v: Array, t: Array) -> Array:
        k = model.instant(r, v, t)
        if model.line.axial.elastic:  # accelerations are not needed
            return model.tension_by_law(k)
        return solve_instant(k, model.end_acceleration(t))[1]

    return jax.vmap(one)(r, v, t)


@cached_jit()
def _sizes(model: Model, dr: Array, dv: Array) -> Array:
    return jax.vmap(partial(perturbation_size, model))(dr, dv)
