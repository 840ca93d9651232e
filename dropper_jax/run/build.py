"""Model, stepper and start of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene
from dropper_jax.model import Model, State
from dropper_jax.run.arrays import bare_model, static_pose
from dropper_jax.run.growth import overgrown
from dropper_jax.run.start import initial_state
from dropper_jax.scene import RunSpec
from dropper_jax.statics.static_pose import Equilibrium
from dropper_jax.stepping.choose import make_stepper
from dropper_jax.stepping.stepper import Stepper

SceneLike = str | Path | Mapping[str, Any] | Scene


def build_model(scene: Scene, dtype: str | None = None) -> Model:
    """The model of a scene, with arrays of `dtype` (default: the scene's precision)."""
    return bare_model(overgrown(scene), dtype)


def stepper_of(model: Model, run: RunSpec, **settings: Any) -> Stepper:
    """The stepper of a scene's `[run]`."""
    return make_stepper(model, run.integrator, run.solver, **run.options, **settings)


def build(scene: SceneLike, dtype: str | None = None) -> tuple[Model, State]:
    """Model and initial state of a scene: what the functional core works on."""
    scene = load_scene(scene)
    model = build_model(scene, dtype)
    return model, initial_state(model, scene.start)


def equilibrium(scene: SceneLike) -> Equilibrium:
    """The static pose of a scene, held by its release force where it has one."""
    scene = load_scene(scene)
    return static_pose(scene, build_model(scene))
