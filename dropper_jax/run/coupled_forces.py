"""Forces on fixed points: tensions of their lines, and the loads on the half links that belong to them."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.numerics import safe_norm
from dropper_jax.model import HolonomicConstraint, Law, Model, State, as_parted
from dropper_jax.model.slots import Force


def set_free(model: Model, points: tuple[int, ...]) -> Model:
    """The model with these fixed points released, and those of its forces that act on any node.

    The first point of a single line stays fixed: no part of a link belongs to it.

    Raises:
        SceneError: compound links, whose ends share their inertia with the points.
    """
    line = model.line
    if line.compound:
        raise SceneError(
            "points: ends of compound links, whose inertia they share; allowed: points of point-mass links"
        )
    kept = []
    for effect in model.effects:
        of_some = isinstance(effect, (Law, HolonomicConstraint)) or effect.bodily or effect.single_line
        if not (isinstance(effect, Force) and of_some):
            kept.append(effect)
    freed = replace(line, geometry=line.geometry.without_fixed(points))
    return replace(model, lines=(freed,), effects=tuple(kept))


def point_forces(model: Model, s: State, points: tuple[int, ...]) -> Array:
    """Forces (c, 3) [N] on fixed points: tensions along their links and forces of effects."""
    seen = as_parted(model.with_internal_state(s.own), s.parted)
    graph = seen.geometry
    ends = seen.ends(s.t)
    links = seen.links(s.r, ends)
    held_forces = graph.held_force((s.tension / safe_norm(links))[:, None] * links)
    rows = [list(graph.held_points).index(point) for point in points]
    # forces of the effects on the nodes of the freed model
    free = set_free(model, points).with_internal_state(s.own)
    nodes = np.concatenate([np.arange(graph.inner), graph.point_node[free.geometry.free_points]])
    r = graph.everywhere(s.r, ends.positions)[nodes]
    velocities = jnp.zeros_like(ends.positions) if ends.velocities is None else ends.velocities
    v = graph.everywhere(s.v, velocities)[nodes]
    return held_forces[np.array(rows)] + _at(free, points, free.force(free.instant(r, v, s.t)))


def half_link_mass(model: Model, points: tuple[int, ...]) -> Array:
    """Mass (c,) [kg] of the halves of links at the points."""
    free = set_free(model, points)
    return _at(free, points, free.line.node_mass[:, None])[:, 0]


def _at(free: Model, points: tuple[int, ...], nodal: Array) -> Array:
    """Rows of the points of a field of the freed model (nodes, ...); zero for a point that stays fixed."""
    return free.geometry.everywhere(nodal, None)[free.geometry.point_node[list(points)]]
