"""The equations of a pose at rest, and Newton on them."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from dropper_jax.base.programs import kept
from dropper_jax.model import Model, State, state
from dropper_jax.residual import GRAVITY_SCALE, Solver, StepProblem, Unknowns, damped_newton
from dropper_jax.solvers import SOLVERS
from dropper_jax.solvers.dense import Dense, residual_matrix

#: Largest scaled row (forces by m g, elongations by L) of an accepted pose.
STATIC_TOLERANCE = 1e-10
#: Unknowns up to which LU of the whole Jacobian is used.
DENSE_LIMIT = 200


class StaticProblem(StepProblem):
    """Unknowns: x = r, y = T, at rest at the state's time."""

    def __init__(self, model: Model, s: State, loads: jax.Array) -> None:
        super().__init__(model, s, jnp.ones((), model.dtype))
        self.loads = loads
        self.ends = model.ends(s.t)
        k = model.kinematics(s.r, jnp.zeros_like(s.r), s.t, self.ends)
        self.prepared = model.prepare(k)

    def residual(self, u: Unknowns) -> Unknowns:
        model, line = self.model, self.model.line
        k = model.kinematics(u.x, jnp.zeros_like(u.x), self.s.t, self.ends, prepared=self.prepared)
        if model.sea is not None:  # a current meets the line as it lies in the end, not as it was guessed
            k = model.instant(k.r, k.v, k.t, self.ends)
        direction = line.axial.direction(k.links, k.links, k.links, line.length)
        rows = -(model.force(k) + self.loads + model.pull(u.y, direction))
        return Unknowns(rows, line.axial.at_rest(k.links, u.y, line.length))

    def row_scale(self) -> Unknowns:
        line = self.model.line
        weight = GRAVITY_SCALE * jnp.mean(line.mass) * jnp.ones((self.model.free_nodes, 1), self.model.dtype)
        return Unknowns(weight, line.length)


def static_solver(model: Model) -> Solver:
    """The solver of the exact Jacobian that is cheaper for the model."""
    if SOLVERS["dense"].size(model) <= DENSE_LIMIT:
        return SOLVERS["dense"]
    return SOLVERS["banded"]


@dataclass(frozen=True)
class LeastNorm(Dense):
    """The shortest correction, where the pose may turn freely (ends above one another) and the Jacobian is singular."""

    name: str = "least_norm"

    def factor(self, problem: StepProblem, u: Unknowns, prepared: None = None) -> jax.Array:
        return residual_matrix(problem, u)

    def apply(self, factor: jax.Array, rows: Unknowns) -> Unknowns:
        flat, unravel = ravel_pytree(rows)
        return unravel(jnp.linalg.lstsq(factor, flat)[0])


@kept(static=("solver", "iterations"), brief=True)
def _newton(
    model: Model, s: State, loads: jax.Array, solver: Solver, iterations: int = 25
) -> tuple[jax.Array, jax.Array, jax.Array]:
    problem = StaticProblem(model, s, loads)
    u, residual = damped_newton(problem, solver, Unknowns(s.r, s.tension), iterations)
    return u.x, u.y, residual


def static_tolerance(model: Model) -> float:
    """Largest scaled row of an accepted pose in the model's precision."""
    return STATIC_TOLERANCE if model.dtype == jnp.float64 else 1e-3


def solve_statics(model: Model, s: State, loads: jax.Array, t: float, solver: Solver = None) -> tuple[State, float]:
    """The pose next to that of `s`, and its largest scaled row."""
    r, tension, residual = _newton(model, s, loads, solver or static_solver(model))
    return state(model, r, tension=tension, t=t), float(residual)
