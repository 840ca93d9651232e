"""Equilibria of a design in calm water and their derivatives by the variables, for the starts of its runs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model, State, state
from dropper_jax.modelling.model_slopes import shift_model
from dropper_jax.statics.descent import find_rest
from dropper_jax.statics.host_stiffness import stiffness
from dropper_jax.statics.rest_problem import system_tolerance, unbalanced
from dropper_jax.statics.static_pose import equilibrium
from fitting.farm.optimise.calm_model import CalmModel, numbered_slopes


@dataclass(frozen=True)
class EquilibriumSlopes:
    """An equilibrium.

    Attributes:
        state: positions and tensions.
        dr: derivative of the positions by the variables (p, free, 3) [m per unit].
        dtension: that of the tensions (p, n) [N per unit].
    """

    state: State
    dr: np.ndarray
    dtension: np.ndarray


def find_equilibrium(model: Model, near: State | None) -> State:
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


def find_equilibrium_slopes(calm: CalmModel, near: State | None = None) -> EquilibriumSlopes:
    """The equilibrium and its derivatives by the variables.

    F(r, p) = 0  ->  dr/dp = -K^-1 dF/dp,    K = dF/dr (sparse, all forces)
    """
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    s = find_equilibrium(calm.model, near)
    loads = jnp.zeros_like(s.r)
    slopes = numbered_slopes(calm.model, calm)
    by_variables = partial(_by_variables, tuple(slopes), calm.model, list(slopes.values()), s)
    fixed = np.zeros((len(next(iter(slopes.values()))), *s.r.shape))
    rows = np.asarray(by_variables(fixed)[0])
    try:
        matrix = splu(stiffness(calm.model, s, loads).tocsc())
    except RuntimeError:
        raise SceneError(
            "design: it has unsupported parts, so its equilibrium is not unique. Use another design"
        ) from None
    dr = -matrix.solve(rows.reshape(len(rows), -1).T).T.reshape(rows.shape)
    return EquilibriumSlopes(s, dr, np.asarray(by_variables(dr)[1]))


@cached_jit(static=("moving",))
def _by_variables(
    moving: tuple[int, ...], model: Model, slopes: list[np.ndarray], s: State, dr: np.ndarray
) -> tuple[Array, Array]:
    """Derivative of minus the forces (p, free, 3), and of the tensions (p, n); positions move by dr (p, free, 3)."""

    def rows(shift: Array) -> tuple[Array, Array]:
        own = shift_model(model, moving, slopes, shift)
        r = s.r + jnp.tensordot(shift, dr, axes=1)
        return unbalanced(own, state(own, r, t=s.t), jnp.zeros_like(r))

    zero = jnp.zeros(len(dr), s.r.dtype)
    return jax.vmap(lambda direction: jax.jvp(rows, (zero,), (direction,))[1])(jnp.eye(len(zero), dtype=s.r.dtype))
