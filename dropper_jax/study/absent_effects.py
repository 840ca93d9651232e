"""Models without some of their effects, and the proof that absent effects have no cost."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.fields import component, parameter
from dropper_jax.base.read import Table
from dropper_jax.base.records import select_keys
from dropper_jax.effects import EFFECTS
from dropper_jax.load.scene import Scene
from dropper_jax.model import Effect, Kinematics, Model, State, state
from dropper_jax.modelling.build import build, build_model, stepper_of
from dropper_jax.residual import Stepper
from dropper_jax.stepping.integrate import advance
from dropper_jax.stepping.progress import Progress, begin
from dropper_jax.stepping.stepper import make_stepper


@component
class Unused(Effect):
    """An effect that no scene uses; it represents any effect added to the package later."""

    name = "unused_effect_of_the_proof"
    strength: Array = parameter("strength", unit="N", low=0.0)

    def force(self, k: Kinematics) -> Array:
        return self.strength * jnp.cosh(k.r)


def without_effects(model: Model, names: list[str]) -> Model:
    """The model without these effects, and without those that need one of them."""
    left_out = set(names)
    kept = [effect for effect in model.effects if left_out.isdisjoint((effect.name, *effect.needs))]
    return replace(model, effects=tuple(kept))


def initial_progress(stepper: Stepper, model: Model, s: State) -> Progress:
    """The start of a run of the model, from the positions, velocities and tensions of a state."""
    return begin(stepper, model, state(model, s.r, s.v, s.tension))


def proof(scene: Scene) -> Table:
    """Compare compiled programs as identical text.

    `removed_is_never_had`: a scene without its optional effects gives the same program as one that never had them.
    `new_effect_changes_nothing`: one more effect class in the registry of the package does not change the program of
    the scene.
    """
    base = program(scene)
    EFFECTS[Unused.name] = Unused
    try:
        again = program(Scene.from_dict(scene.to_dict()))
    finally:
        del EFFECTS[Unused.name]
    table = scene.to_dict()
    run = scene.run
    kept = select_keys(table["effects"], ("weight",))
    model, s = build(scene)

    def text_of(smaller: Model) -> str:
        return step_program(make_stepper(smaller, run.integrator, "auto", **run.options), smaller, s, run.step)

    removed = text_of(without_effects(model, [name for name in scene.effects if name not in kept]))
    never_had = text_of(build_model(Scene.from_dict({**table, "effects": kept})))
    return {
        "removed_is_never_had": removed == never_had,
        "new_effect_changes_nothing": base == again,
        "program_lines": base.count("\n"),
        "contains_cosh": "cosh" in base,
    }


def program(scene: Scene) -> str:
    """The text of the program of one step of a scene before compilation."""
    model, s = build(scene)
    return step_program(stepper_of(model, scene.run), model, s, scene.run.step)


def step_program(stepper: Stepper, model: Model, s: State, dt: float) -> str:
    """The text of the program of one step."""
    start = initial_progress(stepper, model, s)
    return jax.jit(partial(advance, stepper, saves=1)).lower(model, start, jnp.asarray(dt, model.dtype)).as_text()
