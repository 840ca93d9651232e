"""Tensions at an instant, from positions and velocities alone: what a step's tension is compared with."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.integrators.consistent import instant
from dropper_jax.model import Model


def instant_tension(model: Model, r: np.ndarray, v: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Tensions (k, n) [N] of states r, v (k, nodes, 3) at times t (k,).

    Rigid links: the T for which no link's length accelerates, `d . d'' + |d'|^2 = 0` with `M a = F + G' T`;
    elastic ones: their law. NaN for models with set-valued laws, whose forces a state does not determine.
    """
    if model.laws:
        return np.full((len(t), model.line.links), np.nan)
    return np.asarray(jax.jit(jax.vmap(_tension, in_axes=(None, 0, 0, 0)))(model, r, v, jnp.asarray(t, model.dtype)))


def _tension(model: Model, r: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
    k = model.instant(r, v, t)
    if model.line.axial.elastic:  # no need of accelerations
        return model.line.axial.tension(k.links, k.link_velocities, model.line.length)
    return instant(k, model.end_acceleration(t) if model.moving else None)[1]
