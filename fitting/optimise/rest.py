"""Equilibrium of a design, and its derivatives with respect to the variables.

F(r, p) = 0  ->  dr/dp = -K^-1 dF/dp,    K = dF/dr (sparse, all forces)
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model, State, state
from dropper_jax.statics.rest_problem import system_tolerance, unbalanced
from dropper_jax.statics.static_pose import equilibrium
from dropper_jax.statics.system import find_rest
from dropper_jax.statics.tangent import stiffness
from fitting.optimise.models import Still


@dataclasses.dataclass(frozen=True)
class Rest:
    """An equilibrium.

    Attributes:
        state: positions and tensions.
        dr: derivative of the positions by the variables (p, free, 3) [m per unit].
        dtension: that of the tensions (p, n) [N per unit].
    """

    state: State
    dr: np.ndarray
    dtension: np.ndarray


def near_rest(model: Model, near: State | None) -> State:
    """The equilibrium of a model in calm water, solved from a nearby one if given.

    Raises:
        SceneError: no equilibrium was found.
    """
    loads = jnp.zeros((model.free_nodes, 3), model.dtype)
    if near is not None:
        tolerance = system_tolerance(model)
        found, residual = find_rest(model, near, loads, tolerance)
        if residual <= tolerance:
            return state(model, found.r, tension=found.tension)
    found = equilibrium(model)
    if found.status != "ok":
        raise SceneError(f"design: {found.message}")
    return found.state


def rest(still: Still, near: State | None = None) -> Rest:
    """The equilibrium and its derivatives by the variables."""
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    s = near_rest(still.model, near)
    loads = jnp.zeros_like(s.r)
    count = next(iter(still.slopes.values())).shape[0]
    table = tuple(still.slopes)
    slopes = [jnp.asarray(still.slopes[i]) for i in table]
    rows, force = (np.asarray(a) for a in _by_variables(table, still.model, slopes, s, loads))
    try:
        matrix = splu(stiffness(still.model, s, loads).tocsc())
    except RuntimeError:
        raise SceneError(
            "design: it has unsupported parts, so its equilibrium is not unique. Use another design"
        ) from None
    dr = -matrix.solve(rows.reshape(count, -1).T).T.reshape(count, *s.r.shape)
    along = _along(still.model, s, loads, jnp.asarray(dr))
    return Rest(s, dr, force + np.asarray(along))


@cached_jit(static=("moving",))
def _by_variables(
    moving: tuple[int, ...], model: Model, slopes: list[jax.Array], s: State, loads: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Derivative of minus the forces (p, free, 3), and of the tensions (p, n), at fixed positions."""
    leaves, tree = jax.tree.flatten(model)

    def rows(shift: jax.Array) -> tuple[jax.Array, jax.Array]:
        moved = list(leaves)
        for i, slope in zip(moving, slopes, strict=True):
            moved[i] = leaves[i] + jnp.tensordot(shift, slope, axes=1)
        own = jax.tree.unflatten(tree, moved)
        return unbalanced(own, state(own, s.r, t=s.t), loads)

    zero = jnp.zeros(len(slopes[0]), s.r.dtype)
    return jax.vmap(lambda direction: jax.jvp(rows, (zero,), (direction,))[1])(jnp.eye(len(zero), dtype=s.r.dtype))


@cached_jit()
def _along(model: Model, s: State, loads: jax.Array, ways: jax.Array) -> jax.Array:
    """Derivatives of the tensions (p, n) along directions of the positions (p, free, 3)."""
    tension = lambda r: unbalanced(model, state(model, r, t=s.t), loads)[1]  # noqa: E731
    return jax.vmap(lambda direction: jax.jvp(tension, (s.r,), (direction,))[1])(ways)
