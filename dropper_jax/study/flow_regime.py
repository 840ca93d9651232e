"""Flow regime of a run: Keulegan-Carpenter and Reynolds numbers, and diameter over wavelength."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.constants import VISCOSITY
from dropper_jax.model import Model
from dropper_jax.modelling.build import build_model
from dropper_jax.run.row_store import take_every
from dropper_jax.run.simulate import Solution
from dropper_jax.sea import Sea

#: Maximum number of times at which the water is evaluated.
MAX_TIMES = 400


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
    every = max(1, math.ceil(len(solution.t) / MAX_TIMES))
    ends, links = _far_ends(solution, model)
    nodes, v, t = (take_every(a, every) for a in (solution.positions, solution.velocities, solution.t))
    arrays = map(jnp.asarray, (ends, nodes, v[:, ends], t))
    speed = np.asarray(_normal_speeds(model.sea, *arrays)).max(axis=0)
    diameter = np.asarray(model.line.drag_diameter)[links]
    period = shortest = float("nan")
    if model.sea.waves is not None:
        period = float(model.sea.waves.peak_period)
        shortest = float(model.sea.waves.shortest)
    return {
        "relative_speed_m_per_s": float(speed.max()),
        "keulegan_carpenter": np.max(speed / diameter) * period,
        "reynolds": np.max(speed * diameter) / VISCOSITY,
        "diameter_over_wavelength": diameter.max() / shortest,
    }


@cached_jit()
def _normal_speeds(sea: Sea, ends: Array, nodes: Array, v: Array, t: Array) -> Array:
    """Speeds (k, m) [m/s] of the water normal to the links, relative to their far nodes; 0 above the surface.

    Args:
        ends: far nodes of the links (m,); the node before each is the link's other one.
        nodes: positions of all nodes (k, n, 3) [m] at times t (k,) [s].
        v: velocities of the far nodes (k, m, 3) [m/s].
    """

    def speeds_at(nodes: Array, v: Array, t: Array) -> Array:
        r = nodes[ends]
        along = r - nodes[ends - 1]
        # the ends of a slack rope may coincide
        tangent = along / jnp.maximum(jnp.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        motion = sea.at(r, t)
        u = jnp.where((r[:, 2] < motion.elevation)[:, None], motion.velocity - v, 0.0)
        return jnp.linalg.norm(u - jnp.sum(u * tangent, axis=1, keepdims=True) * tangent, axis=1)

    return jax.vmap(speeds_at)(nodes, v, t)


def _far_ends(solution: Solution, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Far node of each link, and the links. Of a single line a link that ends at a fixed point is left out."""
    nodes = np.concatenate([np.arange(line.nodes.start + 1, line.nodes.stop) for line in solution.lines])
    count = len(nodes)
    if model.geometry.is_path:
        count = model.free_nodes
    return nodes[:count], np.arange(count)
