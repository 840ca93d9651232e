"""Initial state of a run: a released equilibrium, given angles, or given positions."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.integrators.consistent import instant
from dropper_jax.model import Displacement, Model, State, state
from dropper_jax.scene import StartSpec
from dropper_jax.statics.static_pose import equilibrium, nodal_loads, settle


def link_directions(polar: jax.Array, azimuth: jax.Array, zero: str) -> jax.Array:
    """Unit link vectors (n, 3) of polar and azimuth angles (n,) [rad], polar from the horizontal or from straight down.

    horizontal: (cos p cos a, cos p sin a, -sin p), the thesis' (4.3)-(4.5); down: (sin p cos a, sin p sin a, -cos p).
    """
    across, drop = (jnp.cos(polar), jnp.sin(polar)) if zero == "horizontal" else (jnp.sin(polar), jnp.cos(polar))
    return jnp.stack([across * jnp.cos(azimuth), across * jnp.sin(azimuth), -drop], axis=-1)


def from_angles(
    model: Model,
    polar: jax.Array,
    azimuth: jax.Array,
    polar_rate: jax.Array,
    azimuth_rate: jax.Array,
    zero: str = "horizontal",
) -> State:
    """The state of links with these angles [rad] and rates [rad/s], each (n,); differentiable in all of them."""

    def nodes(p: jax.Array, a: jax.Array) -> jax.Array:
        links = model.line.length[:, None] * link_directions(p, a, zero)
        return model.points[model.geometry.members[0].start].position + jnp.cumsum(links, axis=0)

    angles = jnp.asarray(polar, model.dtype), jnp.asarray(azimuth, model.dtype)
    rates = jnp.asarray(polar_rate, model.dtype), jnp.asarray(azimuth_rate, model.dtype)
    r, v = jax.jvp(nodes, angles, rates)
    return state(model, r[: model.free_nodes], v[: model.free_nodes])


def with_points_fixed(model: Model) -> Model:
    """The lines alone, with all points fixed at their positions in the scene."""
    graph = replace(model.geometry, held=(True,) * len(model.points))
    carried = ("point_bodies", "spar_buoys")
    drop = lambda e: e.name in carried or e.bodily or isinstance(e, Displacement)  # noqa: E731
    effects = tuple(e for e in model.effects if not drop(e))
    return replace(model, lines=(replace(model.line, geometry=graph),), effects=effects)


def between_points(model: Model, near: State | None = None) -> State:
    """At rest with all points at their positions in the scene and the lines in equilibrium between them.

    With `near`, such a state of a similar design, it is differentiable in the model.

    Raises:
        SceneError: the lines have no equilibrium.
    """
    held = with_points_fixed(model)
    positions = [model.points[int(i)].position for i in model.geometry.free_points]
    if not held.free_nodes:
        return state(model, jnp.stack(positions))
    beside = None if near is None else state(held, near.r[: held.free_nodes], tension=near.tension)
    s = _equilibrium_state(held, None) if beside is None else settle(held, beside)
    r = jnp.concatenate([s.r, jnp.stack(positions)]) if positions else s.r
    return state(model, r, tension=s.tension)


def _equilibrium_state(model: Model, loads: jax.Array | None) -> State:
    pose = equilibrium(model, loads)
    if pose.status not in ("ok", "traced"):
        raise SceneError(f"start: {pose.message}")
    return pose.state


def initial_state(model: Model, start: StartSpec, near: State | None = None) -> State:
    """The state at t = 0 that a scene's `[start]` describes.

    An equilibrium, and lines in equilibrium between given points, depend on the model, with derivatives by the implicit
    function theorem. Inside `jit` and `vmap` they need `near`, the state of a similar design, as the initial guess.

    Raises:
        SceneError: no equilibrium found; the message gives the node and the reason.
    """
    if start.is_static:
        loads = nodal_loads(model, start.release_nodes, start.release_force)
        if near is None:
            return _with_body_velocities(model, _equilibrium_state(model, loads))
        return _with_body_velocities(model, settle(model, state(model, near.r, tension=near.tension), loads))
    return _under_tension(model, _with_body_velocities(model, _state_of_spec(model, start, near)))


def _with_body_velocities(model: Model, s: State) -> State:
    """The state with the initial velocities of bodies."""
    for bodies in model.constraints:
        s = replace(s, v=s.v + bodies.initial_velocities(model, s.r))
    return s


def _state_of_spec(model: Model, start: StartSpec, near: State | None) -> State:
    if start.kind == "points":
        return between_points(model, near)
    if start.kind == "angles":
        return from_angles(model, start.polar, start.azimuth, start.polar_rate, start.azimuth_rate, start.zero)
    free = slice(1, 1 + model.free_nodes)
    velocities = None if start.velocities is None else start.velocities[free]
    return state(model, start.positions[free], velocities)


@cached_jit(brief=True)
def _under_tension(model: Model, s: State) -> State:
    """The state with the tensions of its first instant."""
    acting = model.with_internal_state(s.own)
    if acting.constraints:  # lines in scenes with bodies stretch, so their lengths determine their tensions
        k = acting.kinematics(s.r, s.v, s.t)
        return replace(s, tension=acting.line.axial.tension(k.links, k.link_velocities, acting.line.length))
    moved = acting.end_acceleration(s.t) if acting.moving else None
    return replace(s, tension=instant(acting.instant(s.r, s.v, s.t), moved)[1])
