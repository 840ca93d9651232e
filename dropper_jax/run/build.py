"""Model, stepper and start of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene
from dropper_jax.model import Model, State
from dropper_jax.run.arrays import bare_model, static_pose
from dropper_jax.run.flow_coefficients import with_flow_coefficients
from dropper_jax.run.growth import overgrown
from dropper_jax.run.start import initial_state
from dropper_jax.run.wakes import with_wakes
from dropper_jax.scene import RunSpec
from dropper_jax.statics.modes import Linearised, linearised_about
from dropper_jax.statics.search import Equilibrium
from dropper_jax.statics.static_pose import equilibrium as model_equilibrium
from dropper_jax.statics.static_pose import nodal_loads
from dropper_jax.stepping.stepper import Stepper, make_stepper

#: Minimum error tolerance in units of rounding.
TOLERANCE_ROUNDING = 100.0

SceneLike = str | Path | Mapping[str, Any] | Scene


def build_model(scene: Scene, dtype: str | None = None) -> Model:
    """The model of a scene, with arrays of `dtype` (default: the scene's precision)."""
    return bare_model(with_wakes(with_flow_coefficients(overgrown(scene))), dtype)


def stepper_of(model: Model, run: RunSpec, **settings: Any) -> Stepper:
    """The stepper of a scene's `[run]`."""
    stepper = make_stepper(model, run.integrator, run.solver, **run.options, **settings)
    holds = stepper.integrator.controls_error
    if run.error_tolerance is not None:
        _check_tolerance(run.error_tolerance, run.integrator, holds, model)
    if run.step_tolerance is not None and holds:
        why = f"is given, but integrator {run.integrator!r} controls its own error; use run.error_tolerance"
        raise SceneError(f"run.step_tolerance: {run.step_tolerance:g} {why}")
    return stepper


def equal_steps(model: Model, run: RunSpec, **settings: Any) -> Stepper:
    """The stepper for studies that take equal steps of `run.dt`.

    Raises:
        SceneError: a scheme that controls its own error, whose dt is not a time step.
    """
    stepper = stepper_of(model, run, **settings)
    if stepper.integrator.controls_error:
        why = "controls its own error, but equal steps are needed; allowed: rattle, energy_momentum"
        raise SceneError(f"run.integrator: {run.integrator!r} {why}")
    return stepper


def allowed_error(stepper: Stepper, model: Model, run: RunSpec) -> float:
    """The error tolerance of a step, for schemes that control their error."""
    if run.error_tolerance is not None:
        return run.error_tolerance
    return max(stepper.integrator.tolerance, TOLERANCE_ROUNDING * float(jnp.finfo(model.dtype).eps))


def _check_tolerance(tolerance: float, integrator: str, holds: bool, model: Model) -> None:
    if not holds:
        why = f"is given, but integrator {integrator!r} takes equal steps. Use it with tsit5 or dop853"
        raise SceneError(f"run.error_tolerance: {tolerance:g} {why}")
    least = TOLERANCE_ROUNDING * float(jnp.finfo(model.dtype).eps)
    if tolerance < least:
        why = f"is below the resolution of {model.dtype}; allowed: at least {least:.0e}"
        raise SceneError(f"run.error_tolerance: {tolerance:g} {why}")


def build(scene: SceneLike, dtype: str | None = None) -> tuple[Model, State]:
    """Model and initial state of a scene: what the functional core works on."""
    scene = load_scene(scene)
    model = build_model(scene, dtype)
    return model, initial_state(model, scene.start)


def equilibrium(
    scene: SceneLike | Model, loads: jax.Array | None = None, t: float = 0.0, near: State | None = None
) -> Equilibrium:
    """The equilibrium of a scene, under its release force if it has one, or of a model (see `build`).

    For a model the function has derivatives in forward and reverse mode (implicit function theorem):

        model, start = dj.build("dropper-farm")
        jax.grad(lambda m: dj.equilibrium(m).tension.max())(model)          # solved on the host
        jax.jit(lambda m, near: dj.equilibrium(m, near=near).tension)       # next to a pose near by

    Args:
        scene: packaged name, TOML file, plain values, a `Scene` or a `Model`.
        loads, t, near: for a model: forces (free nodes, 3) [N], time [s], an initial configuration
            (see `statics.static_pose.equilibrium`).
    """
    if isinstance(scene, Model):
        return model_equilibrium(scene, loads, t, near)
    if loads is not None or near is not None or t:
        raise SceneError("loads, t, near: need a model. Use `equilibrium(build(scene)[0], ...)`")
    scene = load_scene(scene)
    return static_pose(scene, build_model(scene))


def linearised(scene: SceneLike) -> Linearised:
    """Small motions of a scene about its equilibrium: M, C, K, and the effect of moving ends on the tensions.

    Raises:
        SceneError: no equilibrium, or a scene that is not smooth there (see `statics.modes`).
    """
    scene = load_scene(scene)
    model = build_model(scene)
    pose = static_pose(scene, model)
    if pose.status != "ok":
        raise SceneError(f"start: {pose.message}")
    return linearised_about(model, pose.state, nodal_loads(model, scene.start.release_nodes, scene.start.release_force))
