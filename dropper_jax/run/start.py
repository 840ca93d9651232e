"""Where a run starts: a static pose let go, given angles, or given positions."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp

from dropper_jax.base.errors import SceneError
from dropper_jax.base.programs import kept
from dropper_jax.integrators.consistent import instant
from dropper_jax.model import Displacement, Model, State, state
from dropper_jax.scene import StartSpec
from dropper_jax.statics.static_pose import equilibrium, nodal_loads


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


def between_points(model: Model) -> State:
    """At rest with all points where the scene puts them and the lines settled between them.

    Raises:
        SceneError: the lines do not settle.
    """
    graph = replace(model.geometry, held=(True,) * len(model.points))
    carried = ("point_bodies", "spar_buoys")
    gone = lambda e: e.name in carried or e.bodily or isinstance(e, Displacement)  # noqa: E731
    effects = tuple(e for e in model.effects if not gone(e))
    places = [model.points[int(i)].position for i in model.geometry.free_points]
    if not graph.free:
        return state(model, jnp.stack(places))
    held = replace(model, lines=(replace(model.line, geometry=graph),), effects=effects)
    pose = equilibrium(held)
    if pose.status != "ok":
        raise SceneError(f"start: {pose.message}")
    r = jnp.concatenate([pose.state.r, jnp.stack(places)]) if places else pose.state.r
    return state(model, r, tension=pose.state.tension)


def initial_state(model: Model, start: StartSpec) -> State:
    """The state at t = 0 that a scene's `[start]` describes.

    Raises:
        SceneError: a static pose that was not found; the message says which node and why.
    """
    if start.kind == "static":
        pose = equilibrium(model, nodal_loads(model, start.release_nodes, start.release_force))
        if pose.status != "ok":
            raise SceneError(f"start: {pose.message}")
        return _pushed(model, pose.state)
    return _under_tension(model, _pushed(model, _given(model, start)))


def _pushed(model: Model, s: State) -> State:
    """The state with the velocities that bodies start with."""
    for bodies in model.ties:
        s = replace(s, v=s.v + bodies.started(model, s.r))
    return s


def _given(model: Model, start: StartSpec) -> State:
    if start.kind == "points":
        return between_points(model)
    if start.kind == "angles":
        return from_angles(model, start.polar, start.azimuth, start.polar_rate, start.azimuth_rate, start.zero)
    free = slice(1, 1 + model.free_nodes)
    velocities = None if start.velocities is None else start.velocities[free]
    return state(model, start.positions[free], velocities)


@kept()
def _under_tension(model: Model, s: State) -> State:
    """The state with the tensions of its first instant."""
    acting = model.entered(s.own)
    if acting.ties:  # lines in scenes with bodies stretch, so that their tensions follow from their lengths
        k = acting.kinematics(s.r, s.v, s.t)
        return replace(s, tension=acting.line.axial.tension(k.links, k.link_velocities, acting.line.length))
    moved = acting.end_acceleration(s.t) if acting.moving else None
    return replace(s, tension=instant(acting.instant(s.r, s.v, s.t), moved)[1])
