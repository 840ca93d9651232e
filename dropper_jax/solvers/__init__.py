"""Solvers of the linear systems of a step: each takes its matrix from `jax.jacfwd` of the residual or of its parts.

    dense       every unknown in a direction of its own, LU                            any model, O(n^3)
    banded      12 directions (more with wider forces), block elimination              one line, O(n)
    condensed   3 directions per node, 4 per link, a tridiagonal system of tensions    one line of point masses, O(n)
    network     the same directions, nodes that are not neighbours eliminated at once  systems of lines

`linearise(problem, u)` gives a factored matrix with `apply(rows)` and `transpose()`. The matrix may be approximate:
Newton converges to the same solution, and derivatives are refined to the exact Jacobian.
"""

from dropper_jax.solvers.banded import Banded
from dropper_jax.solvers.condensed import Condensed
from dropper_jax.solvers.dense import Dense
from dropper_jax.solvers.network import Network

SOLVERS = {solver.name: solver for solver in (Dense(), Banded(), Condensed(), Network())}

__all__ = ["SOLVERS", "Banded", "Condensed", "Dense", "Network"]
