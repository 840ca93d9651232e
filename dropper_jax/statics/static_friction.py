"""Statics of lines that were pulled outward along the seabed, with mobilised friction against the tension.

A line laid out straight from its first point and then pulled at the other end slides as far as the tension reaches.
Friction of up to `mu N` acts on each node on the seabed towards its laid position. Nodes that the tension does not
reach remain there:

    z_i = -K u_i min(1, mu N_i/(K |u_i|)),    u_i = r_i - (laid position), in the plane of the seabed

The tension thus falls by mu w per length to zero and stays there (Jonkman 2007, his CB > 0). K models sticking.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.fields import component
from dropper_jax.base.numerics import safe_norm
from dropper_jax.effects.seabed import Seabed
from dropper_jax.effects.seabed_friction import SeabedFriction
from dropper_jax.model import Effect, Kinematics, Model, State
from dropper_jax.residual import GRAVITY_SCALE
from dropper_jax.statics.rest_problem import force_scale

#: K over the axial stiffness of a link.
GRIP_RATIO = 100.0
#: Minimum displacement [m] at which the friction of a node's weight is reached: a stiffer K would be lost in rounding.
MIN_SLIP = 1e-7


@component
class StaticSeabedFriction(Effect):
    """Friction of nodes on the seabed towards their laid positions: `position` (free, 2) [m], `grip` K (free,)
    [N/m]."""

    name: ClassVar[str] = "laid_out"
    position: Array
    grip: Array
    mu: Array

    def force(self, k: Kinematics) -> Array:
        bed = k.model.effects_with(Seabed)[0]
        u = jnp.concatenate([k.r[:, :2] - self.position, jnp.zeros_like(k.r[:, :1])], axis=1)
        slides = self.mu * bed.normal(k) / safe_norm(u)
        return -jnp.minimum(self.grip, slides)[:, None] * u


def with_static_seabed_friction(model: Model, s: State, mu: Array) -> tuple[Model, Array]:
    """The static model with friction on the inner nodes of all lines, and the rounding error of its rows.

    The latter is in units of `force_scale`, like `system_tolerance`. Differentiable in model and configuration.
    """
    graph = model.geometry
    length = model.line.length
    field = graph.everywhere(s.r, model.ends(s.t).positions)
    stiffness = model.line.axial.axial_stiffness() / length
    positions = []
    grips = []
    for path, span in zip(graph.paths, graph.spans, strict=True):
        start = field[path[0], :2]
        away = field[path[-1], :2] - start
        square = jnp.sum(away**2)
        laid = square > 0.0  # a line that hangs straight down, or a loop, has no laid position
        along = jnp.cumsum(length[span])[:-1, None]
        positions.append(jnp.where(laid, start + along * away / jnp.sqrt(jnp.where(laid, square, 1.0)), 0.0))
        grips.append(jnp.where(laid, GRIP_RATIO * stiffness[span][:-1], 0.0))
    points = graph.free - graph.inner
    position = jnp.pad(jnp.concatenate(positions), ((0, points), (0, 0)))
    grip = jnp.pad(jnp.concatenate(grips), (0, points))
    grip = jnp.minimum(grip, GRAVITY_SCALE * mu * model.line.node_mass / MIN_SLIP)
    extent = jnp.max(jnp.abs(field)) + jnp.max(length)
    rounding = 10.0 * jnp.finfo(model.dtype).eps * jnp.max(grip) * extent
    friction = StaticSeabedFriction(position=position, grip=grip, mu=jnp.asarray(mu))
    return replace(model, effects=(*model.effects, friction)), rounding / force_scale(model)


def static_seabed_friction(full: Model) -> SeabedFriction | None:
    """The static seabed friction of the lines of a system, or None."""
    friction = full.effect("seabed_friction")
    alone = full.geometry.is_path or full.constraints
    if isinstance(friction, SeabedFriction) and friction.statics == "outward" and not alone:
        return friction
    return None
