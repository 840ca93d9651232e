"""Forces on fixed points: tensions of their lines, and the loads on the half links that belong to them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

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
    drop = lambda e: isinstance(e, Force) and (isinstance(e, (Law, HolonomicConstraint)) or e.bodily or e.single_line)  # noqa: E731
    effects = tuple(e for e in model.effects if not drop(e))
    return replace(model, lines=(replace(line, geometry=line.geometry.without_fixed(points)),), effects=effects)


def point_forces(model: Model, free: Model, s: State, points: tuple[int, ...]) -> jax.Array:
    """Forces (c, 3) [N] on fixed points: tensions along their links and forces of effects; `free` is from
    `set_free`."""
    seen = as_parted(model.with_internal_state(s.own), s.parted)
    ends = seen.ends(s.t)
    links = seen.links(s.r, ends)
    held_forces = seen.geometry.held_force((s.tension / safe_norm(links))[:, None] * links)
    rows = [list(seen.geometry.held_points).index(p) for p in points]
    velocities = jnp.zeros_like(ends.positions) if ends.velocities is None else ends.velocities
    own = _effect_forces(seen.geometry, free.with_internal_state(s.own), s, ends.positions, velocities)
    return held_forces[np.array(rows)] + _at(free.geometry, points, own)


def half_link_mass(free: Model, points: tuple[int, ...]) -> jax.Array:
    """Mass (c,) [kg] of the halves of links at the points."""
    return _at(free.geometry, points, free.line.node_mass[:, None])[:, 0]


def _effect_forces(geometry: Any, free: Model, s: State, positions: jax.Array, velocities: jax.Array) -> jax.Array:
    """The effects' forces (nodes, 3) [N] on the nodes of the freed model."""
    nodes = np.concatenate([np.arange(geometry.inner), geometry.point_node[free.geometry.free_points]])
    r = geometry.everywhere(s.r, positions)[nodes]
    v = geometry.everywhere(s.v, velocities)[nodes]
    return free.force(free.instant(r, v, s.t))


def _at(geometry: Any, points: tuple[int, ...], nodal: jax.Array) -> jax.Array:
    """Rows of the points of a field of the freed model (nodes, ...); zero for a point that stays fixed."""
    return geometry.everywhere(nodal, None)[geometry.point_node[list(points)]]
