"""A planar line in minimal coordinates: one angle per link, `d = L (cos a, 0, sin a)`.

[M  -C'] [a'']   [-h - g]          M_ij = mu_ij L_i L_j cos(a_i - a_j),  mu_ij = mass beyond links i and j
[C   0 ] [ l ] = [ turn ]          C: how the held end moves with the angles; rows only where an end is held
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.model import Model, State
from dropper_jax.study.errors import link_vectors


def refuse(model: Model, s: State) -> str | None:
    """Why the model cannot be written so, or None."""
    if [e.name for e in model.effects] != ["weight"] or model.effects[0].wet_weight is not None:
        return "only weight in air is written in angles"
    links = link_vectors(model, np.asarray(s.r)[None], np.zeros(1))
    flat = np.max(np.abs(links[..., 1])) == 0 and np.max(np.abs(np.asarray(s.v))) == 0
    return None if flat else "only planar starts at rest are written in angles"


def start(model: Model, s: State) -> tuple[jax.Array, jax.Array]:
    """Angles and rates (n,) [rad], [rad/s]."""
    links = model.links(s.r, model.ends(s.t))
    angles = jnp.arctan2(links[:, 2], links[:, 0])
    return angles, jnp.zeros_like(angles)


def places(model: Model, angles: jax.Array) -> jax.Array:
    """Free nodes (nodes, 3) [m]."""
    unit = jnp.stack([jnp.cos(angles), jnp.zeros_like(angles), jnp.sin(angles)], axis=-1)
    return (model.ends(0.0).start + jnp.cumsum(model.line.length[:, None] * unit, axis=0))[: model.free_nodes]


def derivative(t: jax.Array, y: tuple[jax.Array, jax.Array], model: Model) -> tuple[jax.Array, jax.Array]:
    """(a', a'')."""
    angles, rates = y
    n, length = model.line.links, model.line.length
    mass = jnp.where(jnp.arange(n) < model.free_nodes, model.line.mass, 0.0)
    beyond = jnp.cumsum(mass[::-1])[::-1]
    shared = jnp.minimum(beyond[:, None], beyond[None, :]) * length[:, None] * length[None, :]
    turn = angles[:, None] - angles[None, :]
    matrix = shared * jnp.cos(turn)
    load = -(shared * jnp.sin(turn)) @ rates**2 - model.effects[0].gravity * beyond * length * jnp.cos(angles)
    if not model.end_held:
        return rates, jnp.linalg.solve(matrix, load)
    close = length * jnp.stack([-jnp.sin(angles), jnp.cos(angles)])
    bend = (length * jnp.stack([jnp.cos(angles), jnp.sin(angles)])) @ rates**2
    whole = jnp.block([[matrix, -close.T], [close, jnp.zeros((2, 2))]])
    return rates, jnp.linalg.solve(whole, jnp.concatenate([load, bend]))[:n]
