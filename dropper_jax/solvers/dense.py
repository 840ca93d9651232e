"""The reference: `jax.jacfwd` of the residual and LU with pivoting. O(n^3) per factorisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.flatten_util import ravel_pytree
from jax.scipy.linalg import lu_factor, lu_solve

from dropper_jax.model import Model
from dropper_jax.residual import Implicit, Solver, StepProblem, Unknowns

#: Diagonal added for the unknowns of laws, far below their rows, which have the same size. They are undetermined if
#: several joints stick; Newton still converges to one of the solutions.
SHARING = 1e-9


class LU(NamedTuple):
    """A factored matrix, or its transpose."""

    factors: tuple[Array, Array]
    transposed: bool = False

    def apply(self, rows: Unknowns) -> Unknowns:
        flat, unravel = ravel_pytree(rows)
        return unravel(lu_solve(self.factors, flat, trans=int(self.transposed)))

    def transpose(self) -> LU:
        return self._replace(transposed=not self.transposed)


@dataclass(frozen=True)
class Dense(Solver):
    """LU of the full Jacobian."""

    name: str = "dense"

    def refuse(self, model: Model, integrator: Implicit) -> str | None:
        return None

    def linearise(self, problem: StepProblem, u: Unknowns) -> LU:
        jacobian = residual_matrix(problem, u)
        if u.z:
            sharing = Unknowns(jnp.zeros_like(u.x), jnp.zeros_like(u.y), tuple(jnp.full_like(z, SHARING) for z in u.z))
            jacobian = jacobian + jnp.diag(ravel_pytree(sharing)[0])
        return LU(lu_factor(jacobian))

    def size(self, model: Model) -> int:
        """Number of unknowns."""
        joints = model.line.links + 1
        return 3 * model.free_nodes + model.line.links + joints * sum(law.components for law in model.laws)


def residual_matrix(problem: StepProblem, u: Unknowns) -> Array:
    """The dense Jacobian (N, N) of a step's rows."""
    flat, unravel = ravel_pytree(u)
    return jax.jacfwd(lambda x: ravel_pytree(problem.residual(unravel(x)))[0])(jnp.asarray(flat))
