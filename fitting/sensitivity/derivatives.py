"""Sensitivity of a quantity to parameters: exact local derivatives, and their range of validity.

Local derivatives include the whole run and its static start, in forward and in reverse mode. In a chaotic motion they
grow like exp(lambda t) and soon do not predict the effect of a finite change. The horizon is the time until then.
Averages over windows shorter than the horizon remain meaningful beyond it.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.numerics import safe_norm
from dropper_jax.base.progress import Progress, silent
from dropper_jax.model import Model, Parted, State, state
from dropper_jax.study.lyapunov import horizon, lyapunov
from fitting.parameters.parameter import apply
from fitting.sensitivity.problem import Plan, Study

#: Growth of a small error up to which derivatives are valid: a change of 1 % has then become one of 100 %.
GROWTH = 100.0
#: Fraction of that growth below which the forward derivatives themselves show that a run is not chaotic.
SCREENED = 0.1


@dataclasses.dataclass(frozen=True)
class Local:
    """Derivatives at the scene's values.

    Attributes:
        names, units, values: of the parameters.
        of, unit, value: the quantity.
        forward: dQ/dp (p,).
        horizon: time [s] up to which derivatives are valid; `duration` [s] of the run.
        reverse: dQ/dp by reverse mode (p,); None unless requested.
        exponent: growth rate of small errors [1/s]; None if it was not needed.
        window: length [s] of the windows of the means; None if derivatives are valid for the whole run.
        window_mean, window_error: mean derivative of the windows' values and its standard error (p,).
    """

    names: list[str]
    units: list[str]
    values: np.ndarray
    of: str
    unit: str
    value: float
    forward: np.ndarray
    horizon: float
    duration: float
    reverse: np.ndarray | None = None
    exponent: float | None = None
    window: float | None = None
    window_mean: np.ndarray | None = None
    window_error: np.ndarray | None = None

    @property
    def scaled(self) -> np.ndarray:
        """`p/Q dQ/dp` (p,): percentage change of the quantity for 1 % change of the parameter; NaN if Q is 0."""
        return self.forward * self.values / self.value if self.value else np.full(len(self.names), np.nan)

    @property
    def finite(self) -> bool:
        """Whether every step of the run was solved."""
        return bool(np.isfinite(self.value) and np.isfinite(self.forward).all())

    @property
    def trusted(self) -> bool:
        return self.window is None

    @property
    def mismatch(self) -> float | None:
        """Maximum difference of the two modes, relative to the maximum derivative; None without reverse mode."""
        if self.reverse is None:
            return None
        size = float(np.max(np.abs(self.forward), initial=0.0))
        return float(np.max(np.abs(self.forward - self.reverse), initial=0.0)) / size if size else 0.0

    def to_json(self) -> dict[str, Any]:
        """The fields and the properties derived from them."""
        return {**dataclasses.asdict(self), "scaled": self.scaled, "trusted": self.trusted}


@cached_jit(static=("plan",), brief=True)
def _forward(plan: Plan, model: Model, near: State, values: jax.Array) -> tuple[jax.Array, ...]:
    """Derivatives (p,) and value of the quantity; the displacement of nodes by each parameter, `max |dr/dp|` (p,), and
    the maximum extent of a node's motion."""

    def along(direction: jax.Array) -> tuple[jax.Array, ...]:
        at = partial(plan.evaluate, model, near)
        (value, run), (slope, moved) = jax.jvp(at, (values,), (direction,))
        return slope, jnp.max(safe_norm(moved.r)), value, jnp.max(safe_norm(run.r - run.r[0]))

    slopes, reach, value, extent = jax.vmap(along, out_axes=(0, 0, None, None))(jnp.eye(len(values)))
    return slopes, value, reach, extent


@cached_jit(static=("plan",), brief=True)
def _reverse(plan: Plan, model: Model, near: State, values: jax.Array) -> jax.Array:
    return jax.grad(lambda p: plan.evaluate(model, near, p, checkpoint=True)[0])(values)


def local(problem: Study, say: Progress = silent, check: bool = False) -> Local:
    """Exact derivatives of the study at its values, and their range of validity.

    If no parameter's change of 1 % moves any node by more than 10 % of the motion's extent, the derivatives are valid
    for the whole run. Otherwise the growth of small errors is computed by a separate program.

    Args:
        check: also compute the derivatives by reverse mode, and the growth rate in any case.
    """
    at = jnp.asarray(problem.values, problem.model.dtype)
    say(0.0, "forward derivatives")
    forward, value, reach, extent = map(np.asarray, _forward(problem.plan, problem.model, problem.start, at))
    if not (np.isfinite(value) or problem.retries or problem.of.at_rest):
        return local(dataclasses.replace(problem, retries=True), say, check)
    if np.isfinite(value) and not np.isfinite(forward).all():
        problem.check_held()
    run = problem.scene.run
    duration = 0.0 if problem.of.at_rest else run.steps * run.dt
    found = Local(
        names=problem.names,
        units=[p.unit for p in problem.parameters],
        values=problem.values,
        of=problem.of.name,
        unit=problem.of.unit,
        value=float(value),
        forward=forward,
        horizon=duration,
        duration=duration,
    )
    if check:
        say(0.4, "reverse derivatives")
        reverse = np.asarray(_reverse(problem.plan, problem.model, problem.start, at))
        found = dataclasses.replace(found, reverse=reverse)
    moved = reach * [p.scale for p in problem.parameters]
    small = bool(np.all(moved <= SCREENED * GROWTH * extent))
    if problem.of.at_rest or (small and not check):
        say(1.0, "ok")
        return found
    say(0.7, "trust horizon")
    growth = lyapunov(problem.model, problem.start, problem.stepper, run.dt, max(run.steps, 2))
    limit, exponent = horizon(growth, run.dt, GROWTH), float(growth.exponent)
    found = dataclasses.replace(found, horizon=limit, exponent=exponent)
    if limit >= (1 - 1e-9) * duration:
        say(1.0, "ok")
        return found
    mean, error, length = windows(problem, at, limit)
    say(1.0, "ok")
    return dataclasses.replace(found, window=length, window_mean=mean, window_error=error)


def windows(problem: Study, at: jax.Array, length: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean derivative of the quantity over windows of about `length` [s] that start on the motion itself.

    Each window's start is fixed, so that derivatives only accumulate within the window. The result is the effect of a
    parameter on the quantity within one horizon, averaged over the states of the motion.

    Returns:
        mean and standard error (p,), and the windows' length [s].
    """
    every = problem.scene.run.dt * problem.scene.run.save_every
    saves = min(max(2, int(length / every)), problem.scene.run.saves)
    count = problem.scene.run.saves // saves

    @jax.jit
    def derivatives(p: jax.Array) -> jax.Array:
        model = apply(problem.model, problem.parameters, p)
        s = problem.begin(model)
        run = jax.lax.stop_gradient(problem.march(model, s, problem.scene.run.saves))
        pick = jnp.arange(count - 1) * saves + saves - 1
        first = jax.tree.map(
            lambda a, b: jnp.concatenate([a[None], b[pick]]),
            (s.r, s.v, s.tension, s.parted),
            (run.r, run.v, run.tension, run.parted),
        )
        t = jnp.arange(count) * (saves * every)

        def one(r: jax.Array, v: jax.Array, tension: jax.Array, parted: Parted, t: jax.Array) -> jax.Array:
            def value(p: jax.Array) -> jax.Array:
                changed = apply(problem.model, problem.parameters, p)
                now = dataclasses.replace(state(changed, r, v, tension), t=t, parted=parted)
                return problem.measure(changed, now, problem.march(changed, now, saves))

            return jax.jacfwd(value)(p)

        return jax.vmap(one)(*jax.lax.stop_gradient(first), t)

    found = np.asarray(derivatives(at))
    error = found.std(axis=0, ddof=1) / np.sqrt(count) if count > 1 else np.full(found.shape[1], np.nan)
    return found.mean(axis=0), error, saves * every
