"""Model, stepper and initial state of a scene: a released equilibrium, given angles, or given positions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.integrators.consistent_velocities import solve_instant
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.model import Model, State, state
from dropper_jax.modelling.fixed_points import with_points_fixed
from dropper_jax.modelling.flow_coefficients import with_flow_coefficients
from dropper_jax.modelling.growth import overgrown
from dropper_jax.modelling.scene_model import bare_model, static_pose
from dropper_jax.modelling.wakes import with_wakes
from dropper_jax.residual import Stepper
from dropper_jax.scene import RunSpec, StartSpec, directions
from dropper_jax.statics.linearised import Linearised, linearised_about
from dropper_jax.statics.loads import release_loads
from dropper_jax.statics.search import Equilibrium
from dropper_jax.statics.static_pose import equilibrium as model_equilibrium
from dropper_jax.statics.static_pose import settle
from dropper_jax.stepping.stepper import make_stepper


def from_angles(
    model: Model,
    polar: ArrayLike,
    azimuth: ArrayLike,
    polar_rate: ArrayLike,
    azimuth_rate: ArrayLike,
    zero: str = "horizontal",
) -> State:
    """The state of links with these angles [rad] and rates [rad/s], each (n,); differentiable in all of them.

    Args:
        zero: where the polar angle is zero, `horizontal` or `down` (see `scene.start.directions`).
    """

    def nodes(p: Array, a: Array) -> Array:
        links = model.line.length[:, None] * directions(p, a, zero)
        # not `cumsum`, which cannot be part of one kernel
        return model.points[model.geometry.members[0].start].position + jax.lax.associative_scan(jnp.add, links)

    given = tuple(jnp.asarray(values, model.dtype) for values in (polar, azimuth, polar_rate, azimuth_rate))
    r, v = jax.jvp(nodes, given[:2], given[2:])
    return state(model, r[: model.free_nodes], v[: model.free_nodes])


def between_points(model: Model, near: State | None, is_equilibrium: bool) -> State:
    """At rest with all points at their positions in the scene and the lines in equilibrium between them.

    With `near`, such a state of a similar design, it is differentiable in the model (see `initial_state`).

    Raises:
        SceneError: the lines have no equilibrium.
    """
    lines_alone = with_points_fixed(model)
    positions = [model.points[int(i)].position for i in model.geometry.free_points]
    if not lines_alone.free_nodes:
        return state(model, jnp.stack(positions))
    if near is None:
        s = _equilibrium_state(lines_alone, None)
    else:
        guess = state(lines_alone, near.r[: lines_alone.free_nodes], tension=near.tension)
        s = settle(lines_alone, guess, is_equilibrium=is_equilibrium)
    return state(model, jnp.concatenate([s.r, *(position[None] for position in positions)]), tension=s.tension)


def _equilibrium_state(model: Model, loads: Array | None) -> State:
    """The equilibrium of a model under loads (free nodes, 3) [N], or a one-line error."""
    pose = model_equilibrium(model, loads)
    if pose.state is None or pose.status not in ("ok", "traced"):
        raise SceneError(f"start: {pose.message}")
    return pose.state


def initial_state(model: Model, start: StartSpec, near: State | None = None, is_equilibrium: bool = False) -> State:
    """The state at t = 0 that a scene's `[start]` describes.

    An equilibrium, and lines in equilibrium between given points, depend on the model, with derivatives by the implicit
    function theorem. Inside `jit` and `vmap` they need `near`, the state of a similar design, as the initial guess, or,
    with `is_equilibrium`, the initial state of this model, which then only gets derivatives (see `settle`).

    Raises:
        SceneError: no equilibrium found; the message gives the node and the reason.
    """
    if start.is_static:
        loads = release_loads(model, start)
        if near is None:
            s = _equilibrium_state(model, loads)
        else:
            s = settle(model, state(model, near.r, tension=near.tension), loads, is_equilibrium)
    elif start.kind == "points":
        s = between_points(model, near, is_equilibrium)
    elif start.kind == "angles":
        s = from_angles(model, start.polar, start.azimuth, start.polar_rate, start.azimuth_rate, start.zero)
    else:
        nodes = np.concatenate(model.geometry.paths)
        free = np.array([np.flatnonzero(nodes == node)[0] for node in range(model.free_nodes)])
        s = state(model, start.positions[free], start.velocities[free])
    for bodies in model.constraints:
        s = replace(s, v=s.v + bodies.initial_velocities(model, s.r))
    return s if start.is_static else _under_tension(model, s)


@cached_jit()
def _under_tension(model: Model, s: State) -> State:
    """The state with the tensions of its first instant."""
    acting = model.with_internal_state(s.own).with_lengths(s.t)
    if acting.constraints:  # lines in scenes with bodies stretch, so their lengths determine their tensions
        k = acting.kinematics(s.r, s.v, s.t)
        return replace(s, tension=acting.tension_by_law(k))
    moved = acting.end_acceleration(s.t)
    return replace(s, tension=solve_instant(acting.instant(s.r, s.v, s.t), moved)[1])


#: What a section of a scene may ask for before its model is built: mussels, then coefficients of the flow around them,
#: then wakes with these coefficients. Each returns a scene that does not ask for it unchanged.
CHANGES_BEFORE_MODEL = (overgrown, with_flow_coefficients, with_wakes)

SceneLike = str | Path | Mapping[str, Any] | Scene


def build_model(scene: SceneLike, dtype: str | None = None) -> Model:
    """The model of a scene, with arrays of `dtype` (default: the scene's precision)."""
    scene = load_scene(scene)
    for change in CHANGES_BEFORE_MODEL:
        scene = change(scene)
    return bare_model(scene, dtype)


def stepper_of(model: Model, run: RunSpec, **settings: Any) -> Stepper:
    """The stepper of a scene's `[run]`."""
    stepper = make_stepper(model, run.integrator, run.solver, **run.options, **settings)
    if run.accuracy is not None and not stepper.integrator.follows_accuracy:
        why = f"needs an estimate of the error of a step, which integrator {run.integrator!r} has not"
        raise SceneError(f"run.accuracy: {run.accuracy:g} {why}. Use run.dt, energy_momentum or generalized_alpha")
    return stepper


def build(scene: SceneLike, dtype: str | None = None) -> tuple[Model, State]:
    """Model and initial state of a scene: what the functional core works on."""
    scene = load_scene(scene)
    model = build_model(scene, dtype)
    return model, initial_state(model, scene.start)


def equilibrium(
    scene: SceneLike | Model, loads: Array | None = None, t: float = 0.0, near: State | None = None
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
    return linearised_about(model, _equilibrium_state(model, release_loads(model, scene.start)))
