"""Differences between two motions."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import cached_jit
from dropper_jax.model import Model


def link_vectors(model: Model, r: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Link vectors (k, n, 3) [m] of free nodes r (k, nodes, 3) at times t (k,), in the precision of r."""
    return np.asarray(_links(model, jnp.asarray(r), jnp.asarray(t, model.dtype))).astype(r.dtype)


@cached_jit(brief=True)
def _links(model: Model, r: jax.Array, t: jax.Array) -> jax.Array:
    return jax.vmap(lambda nodes, time: model.links(nodes, model.ends(time)))(r, t)


def angles_between(d: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Angle [rad] between link vectors (..., 3) and those of a reference.

    In a plane it is the difference of the polar angles; in space it has no singular direction, unlike an azimuth.
    """
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        u, w = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (d, reference))
        chord = np.linalg.norm(u - w, axis=-1)
        return 2 * np.arcsin(np.minimum(0.5 * chord, 1.0))


def rms(x: np.ndarray) -> float:
    """Root of the mean square; infinite if any entry is not finite."""
    with np.errstate(over="ignore"):
        return float(np.sqrt(np.mean(np.square(x)))) if np.all(np.isfinite(x)) else float("inf")


def rms_angle(d: np.ndarray, reference: np.ndarray) -> float:
    """RMS over times and links of the angle between links [rad]."""
    return rms(angles_between(d, reference))


def rms_position(r: np.ndarray, reference: np.ndarray) -> float:
    """RMS over times and nodes of the distance between nodes [m]."""
    return rms(np.linalg.norm(r - reference, axis=-1))
