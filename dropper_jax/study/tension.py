"""Tensions at an instant, from positions and velocities alone: what a step's tension is compared with."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

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
    line, k = model.line, model.instant(r, v, t)
    if line.axial.elastic:
        return line.axial.tension(k.links, k.link_velocities, line.length)
    zero = jnp.zeros((r.size,), r.dtype)
    turning = model.end_acceleration(t) if model.moving else None

    def inertia(a: jax.Array) -> jax.Array:
        return model.inertia(k, a.reshape(r.shape), turning).ravel()

    mass = jax.jacfwd(inertia)(zero)
    pull = k.links / line.length[:, None]

    def stretching(tension: jax.Array) -> jax.Array:
        force = (model.force(k) + model.pull(tension, pull)).ravel() - inertia(zero)
        a = jnp.linalg.solve(mass, force).reshape(r.shape)
        bend = model.geometry.differences(a, turning)
        return jnp.sum(pull * bend, axis=-1) + jnp.sum(k.link_velocities**2, axis=-1) / line.length

    none = jnp.zeros(line.links, r.dtype)
    return jnp.linalg.solve(jax.jacfwd(stretching)(none), -stretching(none))
