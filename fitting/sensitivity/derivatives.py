"""How much a quantity depends on parameters: exact local derivatives, and how far they can be trusted.

Local derivatives go through the whole run, static start included, in forward and in reverse mode. In a chaotic motion
they grow like exp(lambda t) and soon say nothing about a change of finite size: the horizon tells when, and averages
over windows shorter than that still mean something beyond.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.progress import Progress, silent
from dropper_jax.model import Parted, state
from dropper_jax.study.lyapunov import horizon, lyapunov
from fitting.parameters.parameter import apply
from fitting.sensitivity.problem import Study

#: Growth of a small error up to which derivatives are trusted: a change of 1 % has then become one of 100 %.
GROWTH = 100.0


@dataclasses.dataclass(frozen=True)
class Local:
    """Derivatives at the scene's values.

    Attributes:
        names, units, values: of the parameters.
        of, unit, value: the quantity.
        forward, reverse: dQ/dp by both modes (p,).
        horizon: time [s] up to which derivatives are trusted; `duration` [s] of the run.
        exponent: growth rate of small errors [1/s].
        window: length [s] of the windows of the means; None where the whole run is trusted.
        window_mean, window_error: mean derivative of the windows' values and its standard error (p,).
    """

    names: list[str]
    units: list[str]
    values: np.ndarray
    of: str
    unit: str
    value: float
    forward: np.ndarray
    reverse: np.ndarray
    horizon: float
    duration: float
    exponent: float
    window: float | None = None
    window_mean: np.ndarray | None = None
    window_error: np.ndarray | None = None

    @property
    def scaled(self) -> np.ndarray:
        """`p/Q dQ/dp` (p,): per cent of the quantity for one per cent of the parameter; NaN where Q is 0."""
        return self.forward * self.values / self.value if self.value else np.full(len(self.names), np.nan)

    @property
    def finite(self) -> bool:
        """Whether every step of the run was solved."""
        return bool(np.isfinite(self.value) and np.isfinite(self.forward).all())

    @property
    def trusted(self) -> bool:
        return self.window is None

    @property
    def mismatch(self) -> float:
        """Largest difference of the two modes, relative to the largest derivative."""
        size = float(np.max(np.abs(self.forward), initial=0.0))
        return float(np.max(np.abs(self.forward - self.reverse), initial=0.0)) / size if size else 0.0

    def to_json(self) -> dict[str, Any]:
        """The fields, and what is made of them."""
        return {**dataclasses.asdict(self), "scaled": self.scaled, "trusted": self.trusted}


def local(problem: Study, say: Progress = silent) -> Local:
    """Exact derivatives of the study at its values, and how far to trust them."""
    at = jnp.asarray(problem.values, problem.model.dtype)
    say(0.0, "forward derivatives")
    forward, value = jax.jit(jax.jacfwd(lambda p: 2 * (problem(p),), has_aux=True))(at)
    if not (np.isfinite(value) or problem.retries or problem.of.at_rest):
        return local(dataclasses.replace(problem, retries=True), say)
    if np.isfinite(value) and not np.isfinite(forward).all():
        problem.check_held()
    say(0.4, "reverse derivatives")
    reverse = jax.jit(jax.grad(partial(problem, checkpoint=True)))(at)
    run = problem.scene.run
    limit, exponent, duration = 0.0, 0.0, 0.0
    if not problem.of.at_rest:
        say(0.7, "trust horizon")
        duration = run.steps * run.dt
        growth = lyapunov(problem.model, problem.start, problem.stepper, run.dt, max(run.steps, 2))
        limit, exponent = horizon(growth, run.dt, GROWTH), float(growth.exponent)
    found = Local(
        names=problem.names,
        units=[p.unit for p in problem.parameters],
        values=problem.values,
        of=problem.of.name,
        unit=problem.of.unit,
        value=float(value),
        forward=np.asarray(forward),
        reverse=np.asarray(reverse),
        horizon=limit,
        duration=duration,
        exponent=exponent,
    )
    if limit >= (1 - 1e-9) * duration:
        say(1.0, "ok")
        return found
    mean, error, length = windows(problem, at, limit)
    say(1.0, "ok")
    return dataclasses.replace(found, window=length, window_mean=mean, window_error=error)


def windows(problem: Study, at: jax.Array, length: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean derivative of the quantity over windows of about `length` [s] that start on the motion itself.

    Each window's start is held, so that no derivative is carried further than the window: what a parameter does to
    the quantity within one horizon, averaged over the states that the motion visits.

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
