"""Linear solvers for the Newton correction of a step: dense, banded, condensed; network for systems of lines.

Each offers `refuse(model, integrator)`, `prepare(problem, u)` once per step, `factor(problem, u, prepared)` once per
iteration, `apply(factor, rows)` and `apply_transposed(factor, rows)` on `Unknowns`. The inverted matrix may be
approximate; derivatives are refined to the exact Jacobian.
"""

from dropper_jax.residual import CondensedParts
from dropper_jax.solvers.banded import Banded
from dropper_jax.solvers.condensed import Condensed
from dropper_jax.solvers.dense import Dense
from dropper_jax.solvers.network import Network

SOLVERS = {solver.name: solver for solver in (Dense(), Banded(), Condensed(), Network())}

__all__ = ["SOLVERS", "Banded", "Condensed", "CondensedParts", "Dense", "Network"]
