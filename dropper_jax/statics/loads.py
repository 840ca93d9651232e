"""Loads on free nodes under which a start is in equilibrium, until it is released."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from dropper_jax.base.errors import SceneError
from dropper_jax.base.indexed_sums import scatter_add
from dropper_jax.model import Model
from dropper_jax.scene import StartSpec


def given_loads(model: Model, loads: Array | None) -> Array:
    """Loads (free nodes, 3) [N] of the nodes; zero without any."""
    if loads is None:
        return jnp.asarray(np.zeros((model.free_nodes, 3)), model.dtype)
    return jnp.asarray(loads, model.dtype)


def nodal_loads(model: Model, nodes: Sequence[int] | np.ndarray | None, forces: ArrayLike | None) -> Array:
    """Loads (free nodes, 3) [N] from node numbers (counted from 1) and 3-vectors; zero without `nodes`."""
    if nodes is None or len(nodes) == 0:
        return given_loads(model, None)
    index = np.asarray(nodes, int) - 1
    if np.any(index < 0) or np.any(index >= model.free_nodes):
        raise SceneError(f"start.release_nodes: {list(nodes)}; allowed are free nodes, 1 to {model.free_nodes}")
    if forces is None:
        raise SceneError("start.release_force: missing; needed: a 3-vector [N] for each of the nodes")
    if not isinstance(forces, Array):
        forces = np.asarray(forces, model.dtype)
    return scatter_add(index, forces, model.free_nodes)


def release_loads(model: Model, start: StartSpec) -> Array:
    """The loads (free nodes, 3) [N] under which a start is in equilibrium, until it is released."""
    return nodal_loads(model, start.release_nodes, start.release_force)
