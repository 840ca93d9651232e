"""Flow regime of a run: Keulegan-Carpenter and Reynolds numbers, and diameter over wavelength."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.constants import VISCOSITY
from dropper_jax.model import Model
from dropper_jax.run.build import build_model
from dropper_jax.run.row_store import take_every
from dropper_jax.run.simulate import Solution
from dropper_jax.sea import Sea

#: Maximum number of times at which the water is evaluated.
MOST_TIMES = 400


def regime(solution: Solution) -> dict[str, float]:
    """KC, Reynolds number and D/wavelength of a run, at the node with the maximum of each.

    `KC = u T/D` and `Re = u D/nu`, u is the maximum speed of the water relative to the node, normal to its link [m/s],
    and T the peak period (that of the largest component). Without waves KC and D/wavelength are NaN.

    Raises:
        ValueError: the scene has no water or no diameter.
    """
    model = build_model(solution.scene, "float64")
    if model.sea is None or model.line.diameter is None:
        raise ValueError("solution: its scene has no [sea] or no diameter. Use a scene with both")
    every = max(1, len(solution.t) // MOST_TIMES)
    free, links = _far_ends(solution, model)
    nodes, v, t = (take_every(a, every) for a in (solution.positions, solution.velocities, solution.t))
    arrays = map(jnp.asarray, (free, nodes, v[:, free], t))
    speed = np.asarray(_across(model.sea, *arrays)).max(axis=0)
    diameter = np.asarray(model.line.drag_diameter)[links]
    period = shortest = float("nan")
    if model.sea.waves is not None:
        waves = model.sea.waves
        period = float(2 * np.pi / np.asarray(waves.omega)[int(np.argmax(np.asarray(waves.amplitude)))])
        shortest = float(waves.shortest)
    return {
        "relative_speed_m_per_s": float(speed.max()),
        "keulegan_carpenter": np.max(speed / diameter) * period,
        "reynolds": np.max(speed * diameter) / VISCOSITY,
        "diameter_over_wavelength": diameter.max() / shortest,
    }


@cached_jit()
def _across(sea: Sea, free: Array, nodes: Array, v: Array, t: Array) -> Array:
    """Speeds (k, looked) [m/s] of the water normal to the links before the nodes `free`, relative to the nodes.

    Args:
        nodes: all of them (k, n + 1, 3) [m] at times t (k,) [s].
        v: velocities of the evaluated nodes (k, looked, 3) [m/s].
    """

    def one(nodes: Array, v: Array, t: Array) -> Array:
        r = nodes[free]
        along = r - nodes[free - 1]
        # the ends of a slack rope may coincide
        tangent = along / jnp.maximum(jnp.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        motion = sea.at(r, t)
        u = jnp.where((r[:, 2] < motion.elevation)[:, None], motion.velocity - v, 0.0)
        return jnp.linalg.norm(u - jnp.sum(u * tangent, axis=1, keepdims=True) * tangent, axis=1)

    return jax.vmap(one)(nodes, v, t)


def _far_ends(solution: Solution, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """End nodes of the evaluated links, and the links: of one line all except a fixed end, of a system all."""
    nodes = np.concatenate([np.arange(line.nodes.start + 1, line.nodes.stop) for line in solution.lines])
    count = len(nodes)
    if model.geometry.is_path:
        count = model.free_nodes
    return nodes[:count], np.arange(count)
