"""The reference: `jax.jacfwd` of the residual and LU with pivoting. O(n^3) per factorisation."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.scipy.linalg import lu_factor, lu_solve

from dropper_jax.model import Model
from dropper_jax.residual import Implicit, Solver, StepProblem, Unknowns

LU = tuple[jax.Array, jax.Array]


@dataclass(frozen=True)
class Dense(Solver[None, LU]):
    """LU of the full Jacobian."""

    name: str = "dense"

    def refuse(self, model: Model, integrator: Implicit) -> str | None:
        return None

    def factor(self, problem: StepProblem, u: Unknowns, prepared: None = None) -> LU:
        jacobian = residual_matrix(problem, u)
        return lu_factor(jacobian + _sharing(u) if u.z else jacobian)

    def apply(self, factor: LU, rows: Unknowns, transposed: bool = False) -> Unknowns:
        flat, unravel = ravel_pytree(rows)
        return unravel(lu_solve(factor, flat, trans=int(transposed)))

    def apply_transposed(self, factor: LU, rows: Unknowns) -> Unknowns:
        return self.apply(factor, rows, transposed=True)

    def size(self, model: Model) -> int:
        """Number of unknowns."""
        joints = model.line.links + 1
        return 3 * model.free_nodes + model.line.links + joints * sum(law.components for law in model.laws)


def _sharing(u: Unknowns) -> jax.Array:
    """A small diagonal on the unknowns of laws, which are undetermined if several joints stick; Newton still converges
    to one of the solutions."""
    # diagonal added for laws, far below their unknowns and rows, which have the same size
    mark = Unknowns(jnp.zeros_like(u.x), jnp.zeros_like(u.y), tuple(jnp.full_like(z, 1e-9) for z in u.z))
    return jnp.diag(ravel_pytree(mark)[0])


def residual_matrix(problem: StepProblem, u: Unknowns) -> jax.Array:
    """The dense Jacobian (N, N) of a step's rows."""
    flat, unravel = ravel_pytree(u)
    return jax.jacfwd(lambda x: ravel_pytree(problem.residual(unravel(x)))[0])(jnp.asarray(flat))
