"""Values of a design: equilibria and their derivatives, windows of storms, starts of runs, shadow prices."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model, State, state
from dropper_jax.run.model_slopes import shift_model
from dropper_jax.statics.descent import find_rest
from dropper_jax.statics.host_stiffness import stiffness
from dropper_jax.statics.rest_problem import system_tolerance, unbalanced
from dropper_jax.statics.static_pose import equilibrium
from fitting.farm.optimise.models import Still, numbered_slopes
from fitting.farm.site import Case

#: Distance from its limit up to which a constraint is active.
NEAR_LIMIT = 0.03


@dataclass(frozen=True)
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
    """The equilibrium and its derivatives by the variables.

    F(r, p) = 0  ->  dr/dp = -K^-1 dF/dp,    K = dF/dr (sparse, all forces)
    """
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    s = near_rest(still.model, near)
    loads = jnp.zeros_like(s.r)
    slopes = numbered_slopes(still.model, still)
    by_variables = partial(_by_variables, tuple(slopes), still.model, list(slopes.values()), s)
    fixed = np.zeros((len(next(iter(slopes.values()))), *s.r.shape))
    rows = np.asarray(by_variables(fixed)[0])
    try:
        matrix = splu(stiffness(still.model, s, loads).tocsc())
    except RuntimeError:
        raise SceneError(
            "design: it has unsupported parts, so its equilibrium is not unique. Use another design"
        ) from None
    dr = -matrix.solve(rows.reshape(len(rows), -1).T).T.reshape(rows.shape)
    return Rest(s, dr, np.asarray(by_variables(dr)[1]))


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


@dataclass(frozen=True)
class Window:
    """Window of a case used by the optimiser.

    Attributes:
        begin: [s].
        factor: ratio of the whole run's hard peaks to its soft ones (q,); height: that sizes the soft peaks (q,).
        starts_broken: whether a line that breaks is missing from the start on.
    """

    case: Case
    begin: float
    factor: np.ndarray
    height: np.ndarray | None = None
    starts_broken: bool = False


class RunStart(NamedTuple):
    """Start of a run: calm model with its slopes, equilibrium, and the later model of a window with a broken line."""

    still: Still
    rest: Rest
    after: Still | None = None


@dataclass(frozen=True)
class Values:
    """Objective and constraints of a design; a constraint is met if it is at most 1.

    Attributes:
        objective, slope: and its derivative by variables and assumptions (p + a,).
        names: of the constraints; `value` (m,), `slopes` (m, p + a).
        solved: whether all runs were.
        by_seed: by constraint on a storm, derivatives of the seeds (n, p + a); their mean is that of the constraint.
    """

    objective: float
    slope: np.ndarray
    names: tuple[str, ...]
    value: np.ndarray
    slopes: np.ndarray
    solved: bool = True
    by_seed: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def worst(self) -> float:
        """The largest constraint."""
        return float(np.max(self.value, initial=-np.inf))


def active_constraints(values: Values, limit: float) -> np.ndarray:
    """Numbers of the constraints that count as active: within `NEAR_LIMIT` of their limit, or beyond."""
    return np.flatnonzero(values.value >= limit - NEAR_LIMIT)


class Dominated(NamedTuple):
    """Derivative of a constraint that one seed dominates [1 per unit of the variable]; `seed` counts from 0."""

    constraint: str
    variable: int
    seed: int
    mean: float
    median: float


def dominated_slopes(values: Values, span: np.ndarray, limit: float) -> list[Dominated]:
    """Derivatives of constraints near their limit that one seed moves by more than a quarter of their size.

        max_i |d_i - median(d)| / n > 0.25 max(|mean(d)|, |median(d)|)

    A seed whose peak occurs as a rope becomes taut has such a derivative. Fewer than three seeds have no median.

    Args:
        span: range of each variable (p,); those with less than 5 % of a constraint's largest derivative are left out.
    """
    found = []
    for name in (values.names[i] for i in active_constraints(values, limit)):
        rows = values.by_seed.get(name, np.zeros((0, len(span))))[:, : len(span)]
        if len(rows) < 3:
            continue
        mean = rows.mean(axis=0)
        median = np.median(rows, axis=0)
        size = np.maximum(np.abs(mean), np.abs(median))
        off = np.abs(rows - median)
        seed = off.argmax(axis=0)
        dominated = (off.max(axis=0) / len(rows) > 0.25 * size) & (size * span > 0.05 * np.max(size * span))
        for k in np.flatnonzero(dominated):
            found.append(Dominated(name, int(k), int(seed[k]), float(mean[k]), float(median[k])))
    return found
