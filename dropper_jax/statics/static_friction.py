"""Statics of lines that were pulled outward along the bed: its friction mobilised, against the pull, where they lie.

A line laid out straight from its first point and then pulled at the other end slides as far as the tension reaches.
Each node on the bed is held back by `mu N` towards where it lay; those that the tension does not reach lie there still:

    z_i = -K u_i min(1, mu N_i/(K |u_i|)),    u_i = r_i - (where it was laid), in the plane of the bed

so that the tension falls by mu w per length to zero and stays there (Jonkman 2007, his CB > 0). K stands for sticking.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.fields import component
from dropper_jax.base.numerics import safe_norm
from dropper_jax.base.scatter import scatter_add
from dropper_jax.effects.seabed import Seabed
from dropper_jax.model import Effect, Kinematics, Model, State
from dropper_jax.residual import GRAVITY_SCALE
from dropper_jax.statics.rest_problem import force_scale

#: K over the stiffness of a link, and the way that full friction gives at most [m]: what is stiffer drowns in rounding.
GRIP, GIVE = 100.0, 1e-7


@component
class StaticSeabedFriction(Effect):
    """Friction of nodes on the bed towards where they were laid: `position` (free, 2) [m], `grip` K (free,) [N/m]."""

    name: ClassVar[str] = "laid_out"
    position: jax.Array
    grip: jax.Array
    mu: jax.Array

    def force(self, k: Kinematics) -> jax.Array:
        bed = next(e for e in k.model.effects if isinstance(e, Seabed))
        u = jnp.concatenate([k.r[:, :2] - self.position, jnp.zeros_like(k.r[:, :1])], axis=1)
        slides = self.mu * bed.normal(k) / safe_norm(u)
        return -jnp.minimum(self.grip, slides)[:, None] * u


def with_static_seabed_friction(model: Model, s: State, mu: jax.Array) -> tuple[Model, jax.Array]:
    """The model of a static pose with friction on the inner nodes of all lines, and what rounding leaves of its rows.

    The latter is in `force_scale`, as `system_tolerance` is. Differentiable in model and pose.
    """
    graph, length = model.geometry, model.line.length
    ends = model.ends(s.t).positions
    field = graph.everywhere(s.r, ends)
    stiffness = model.line.axial.EA / length
    inner, positions, grips = [], [jnp.zeros((0, 2), model.dtype)], [jnp.zeros(0, model.dtype)]
    for path, span in zip(graph.paths, graph.spans, strict=True):
        start, end = field[path[0], :2], field[path[-1], :2]
        across = safe_norm(end - start)
        laid = across > 0.0  # a line that hangs straight down, or a loop, has nowhere to be laid
        along = jnp.cumsum(length[span])[:-1, None]
        inner.append(path[1:-1])
        positions.append(jnp.where(laid, start + along * (end - start) / jnp.where(laid, across, 1.0), 0.0))
        grips.append(jnp.where(laid, GRIP * stiffness[span][:-1], 0.0))
    where = np.concatenate(inner).astype(int)
    at = scatter_add(where, jnp.concatenate(positions), graph.free)
    grip = scatter_add(where, jnp.concatenate(grips), graph.free)
    grip = jnp.minimum(grip, GRAVITY_SCALE * mu * model.line.node_mass / GIVE)
    size = jnp.max(jnp.abs(field)) + jnp.max(length)
    rounding = 10.0 * jnp.finfo(model.dtype).eps * jnp.max(grip) * size
    held = StaticSeabedFriction(position=at, grip=grip, mu=jnp.asarray(mu))
    return replace(model, effects=(*model.effects, held)), rounding / force_scale(model)
