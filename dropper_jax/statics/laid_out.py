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
from dropper_jax.effects.seabed import Seabed
from dropper_jax.model import Effect, Kinematics, Model, State
from dropper_jax.residual import GRAVITY_SCALE
from dropper_jax.statics.system import force_scale

#: K over the stiffness of a link, and the way that full friction gives at most [m]: what is stiffer drowns in rounding.
GRIP, GIVE = 100.0, 1e-7


@component
class LaidOut(Effect):
    """Friction of nodes on the bed towards where they were laid: `place` (free, 2) [m], `grip` K (free,) [N/m]."""

    name: ClassVar[str] = "laid_out"
    place: jax.Array
    grip: jax.Array
    mu: jax.Array

    def force(self, k: Kinematics) -> jax.Array:
        bed = next(e for e in k.model.effects if isinstance(e, Seabed))
        u = jnp.concatenate([k.r[:, :2] - self.place, jnp.zeros_like(k.r[:, :1])], axis=1)
        slides = self.mu * bed.normal(k) / safe_norm(u)
        return -jnp.minimum(self.grip, slides)[:, None] * u


def laid_out(model: Model, s: State, mu: jax.Array) -> tuple[Model, float]:
    """The model of a static pose with friction on the inner nodes of all lines, and what rounding leaves of its rows.

    The latter is in `force_scale`, as `system_tolerance` is.
    """
    graph, length = model.geometry, np.asarray(model.line.length, float)
    ends = np.asarray(model.ends(s.t).places, float)
    field = np.asarray(graph.everywhere(s.r, jnp.asarray(ends)), float)
    place, grip = np.zeros((graph.free, 2)), np.zeros(graph.free)
    stiffness = np.asarray(model.line.axial.EA, float) / length
    for path, span in zip(graph.paths, graph.spans, strict=True):
        start, end = field[path[0], :2], field[path[-1], :2]
        across = np.linalg.norm(end - start)
        if across == 0.0:
            continue  # a line that hangs straight down, or a loop, has nowhere to be laid
        along = np.cumsum(length[span])[:-1, None]
        place[path[1:-1]] = start + along * (end - start) / across
        grip[path[1:-1]] = GRIP * stiffness[span][:-1]
    grip = np.minimum(grip, GRAVITY_SCALE * float(mu) * np.asarray(model.line.node_mass) / GIVE)
    rounding = 10.0 * float(jnp.finfo(model.dtype).eps) * np.max(grip) * (np.max(np.abs(field)) + np.max(length))
    held = LaidOut(place=jnp.asarray(place), grip=jnp.asarray(grip), mu=jnp.asarray(mu))
    return replace(model, effects=(*model.effects, held)), rounding / float(force_scale(model))
