"""Derivatives of the hard cases: finite, and equal to central differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.model import Effect, Model, State
from dropper_jax.run.build import build
from dropper_jax.stepping.integrate import integrate
from dropper_jax.stepping.stepper import Stepper, make_stepper
from dropper_jax.study.stability import energy_cases, scenes
from dropper_jax.study.stability.case import Case, Outcome

#: Relative change of the parameter in the central differences.
CHANGE = 1e-5
STEPS = 40


@partial(jax.jit, static_argnums=(0, 4))
def _objective(stepper: Stepper, share: jax.Array, model: Model, s: State, steps: int, dt: jax.Array) -> jax.Array:
    """A fixed combination of the last positions over the link length [-], with a relative change of masses, speeds and
    strengths."""
    line = model.lines[0]
    tilt = 1 + share * jnp.linspace(0.5, 1.5, line.links)
    effects = tuple(_scale_effect(effect, 1 + share) for effect in model.effects)
    changed = replace(model, lines=(replace(line, mass=line.mass * tilt),), effects=effects)
    last, _ = integrate(stepper, changed, replace(s, v=s.v * (1 + share)), dt, steps, steps)
    mix = jnp.sin(jnp.arange(1.0, 1.0 + last.r.size)).reshape(last.r.shape)
    return jnp.mean(mix * last.r) / jnp.mean(line.length)


def _scale_effect(effect: Effect, factor: jax.Array) -> Effect:
    """The effect with its strength scaled: gravity or a damping coefficient; others as they are."""
    for name in ("gravity", "b_l", "b_q"):
        if name in effect.__dataclass_fields__:
            return replace(effect, **{name: getattr(effect, name) * factor})
    return effect


def _gradient(name: str, make: Callable[[], Scene], dt: float) -> Case:
    def measure(short: bool) -> Outcome:
        model, s = build(make())
        value = partial(_objective, make_stepper(model), model=model, s=s, steps=STEPS, dt=dt)
        one = lambda x: value(jnp.asarray(x))  # noqa: E731
        exact = float(_slope(make_stepper(model), model, s, STEPS, dt))
        around = (float(one(CHANGE)) - float(one(-CHANGE))) / (2 * CHANGE)
        scale = max(abs(around), 1e-3)
        return Outcome(abs(exact - around) / scale, "ok" if np.isfinite(exact) else "non_finite")

    claim = f"{name}: derivative after {STEPS * dt:g} s against central differences"
    return Case(f"gradient-{name}", claim, 1e-6, "relative", measure)


@partial(jax.jit, static_argnums=(0, 3))
def _slope(stepper: Stepper, model: Model, s: State, steps: int, dt: jax.Array) -> jax.Array:
    return jax.grad(lambda x: _objective(stepper, x, model, s, steps, dt))(jnp.zeros((), model.dtype))


def _at_rest(short: bool) -> Outcome:
    """A loop at rest in its equilibrium with quadratic damping: derivative of the positions by a common factor of all
    masses must vanish."""
    drag = {"linear_damping": {"b_l": 0.01}, "quadratic_damping": {"b_q": 0.01}}
    model, s = build(scenes.loop("at-rest", 0.3, effects=drag))
    stepper = make_stepper(model)

    def sum_of_positions(share: jax.Array) -> jax.Array:
        line = model.lines[0]
        changed = replace(model, lines=(replace(line, mass=line.mass * (1 + share)),))
        return jnp.sum(integrate(stepper, changed, s, 0.01, STEPS, STEPS)[0].r)

    slope = float(jax.jit(jax.grad(sum_of_positions))(jnp.zeros(())))
    return Outcome(abs(slope) if np.isfinite(slope) else float("inf"), "ok" if np.isfinite(slope) else "non_finite")


def _sticking(short: bool) -> Outcome:
    """Dry friction switches, so its derivative is that of the active set: asked to be finite only."""
    model, s = build(energy_cases.sticky([0.6, 0.2]))
    slope = float(_slope(make_stepper(model), model, s, STEPS, 0.01))
    return Outcome(0.0 if np.isfinite(slope) else 1.0, "ok" if np.isfinite(slope) else "non_finite")


CASES = [
    _gradient("hanging-kicked", scenes.kicked_string, 0.005),
    _gradient("vertical-and-horizontal", energy_cases.turning, 0.005),
    _gradient("undamped-dropper", lambda: load_scene("dropper-release-a-undamped"), 0.01),
    _gradient("ends-at-the-same-point", lambda: scenes.lifted_loop("same-point", 0.0), 0.01),
    _gradient("taut-plucked", lambda: scenes.lifted_loop("taut", 0.999 * 0.7, 2.0), 0.002),
    _gradient("mass-ratio", energy_cases.mass_ratio, 0.0002),
    _gradient("short-link", energy_cases.short_link, 0.01),
    _gradient("large-release", energy_cases.large_release, 0.002),
    _gradient("driven-at-resonance", scenes.driven, 0.01),
    _gradient("whirling-loop", scenes.whirling, 0.002),
    _gradient("heavy-damping", energy_cases.overdamped_pendulum, 0.1),
    _gradient("quadratic-damping-fast", energy_cases.fast, 0.002),
    Case("gradient-at-rest", "a loop at rest: derivative by the masses, which move nothing", 1e-9, "m", _at_rest),
    Case("gradient-dry-friction", "dry friction: derivative is finite (0) or not (1)", 0.0, "-", _sticking),
]
