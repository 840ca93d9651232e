"""Derivatives of runs of the hard cases: finite, and equal to central differences."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.model import Effect, Model, State
from dropper_jax.modelling.build import build
from dropper_jax.residual import Stepper
from dropper_jax.stability.case import Case, Outcome, scene_of, status_of
from dropper_jax.stepping.integrate import integrate
from dropper_jax.stepping.stepper import make_stepper

#: Relative change of the parameter in the central differences.
CHANGE = 1e-5
STEPS = 40
#: Derivatives below this are compared absolutely.
SMALL_DERIVATIVE = 1e-3


def against_differences(case: Case, short: bool) -> Outcome:
    """Relative error of the derivative by `_objective`'s relative change."""
    model, s = build(scene_of(case.scene))
    stepper = make_stepper(model)
    value = partial(_objective, stepper, model=model, s=s, dt=case.dt)
    above, below = (float(value(jnp.asarray(change))) for change in (CHANGE, -CHANGE))
    around = (above - below) / (2 * CHANGE)
    exact = float(_slope(stepper, model, s, case.dt))
    return Outcome(abs(exact - around) / max(abs(around), SMALL_DERIVATIVE), status_of(exact))


def finite(case: Case, short: bool) -> Outcome:
    """Dry friction switches, so its derivative is that of the active set: 0 where it is finite."""
    model, s = build(scene_of(case.scene))
    slope = float(_slope(make_stepper(model), model, s, case.dt))
    return Outcome(float(not np.isfinite(slope)), status_of(slope))


def at_rest(case: Case, short: bool) -> Outcome:
    """The derivative of the positions by a common factor of all masses vanishes in an equilibrium."""
    model, s = build(scene_of(case.scene))
    stepper = make_stepper(model)

    def sum_of_positions(share: Array) -> Array:
        line = model.lines[0]
        changed = replace(model, lines=(replace(line, mass=line.mass * (1 + share)),))
        return jnp.sum(integrate(stepper, changed, s, case.dt, STEPS, STEPS)[0].r)

    slope = float(jax.jit(jax.grad(sum_of_positions))(jnp.zeros(())))
    if not np.isfinite(slope):
        slope = np.inf
    return Outcome(abs(slope), status_of(slope))


@partial(jax.jit, static_argnums=0)
def _objective(stepper: Stepper, share: Array, model: Model, s: State, dt: Array) -> Array:
    """A fixed combination of the last positions over the link length [-], with a relative change of masses, speeds and
    strengths."""
    line = model.lines[0]
    tilt = 1 + share * jnp.linspace(0.5, 1.5, line.links)
    effects = tuple(_scale_effect(effect, 1 + share) for effect in model.effects)
    changed = replace(model, lines=(replace(line, mass=line.mass * tilt),), effects=effects)
    last, _ = integrate(stepper, changed, replace(s, v=s.v * (1 + share)), dt, STEPS, STEPS)
    mix = jnp.sin(jnp.arange(1.0, 1.0 + last.r.size)).reshape(last.r.shape)
    return jnp.mean(mix * last.r) / jnp.mean(line.length)


@partial(jax.jit, static_argnums=0)
def _slope(stepper: Stepper, model: Model, s: State, dt: Array) -> Array:
    """Derivative of the objective by the relative change."""
    return jax.grad(lambda share: _objective(stepper, share, model, s, dt))(jnp.zeros((), model.dtype))


def _scale_effect(effect: Effect, factor: Array) -> Effect:
    """The effect with its strength scaled: gravity or a damping coefficient; others unchanged."""
    for name in ("gravity", "b_l", "b_q"):
        if name in effect.__dataclass_fields__:
            return replace(effect, **{name: getattr(effect, name) * factor})
    return effect
