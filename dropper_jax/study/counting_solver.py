"""A linear solver that counts its corrections, each by a call of the host."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax

from dropper_jax.residual import Linear, Solver, StepProblem, Unknowns


class CountingSolver:
    """A linear solver that counts its corrections."""

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        self.name = solver.name
        self.count = 0

    def linearise(self, problem: StepProblem, u: Unknowns) -> CountedMatrix:
        """The solver's matrix."""
        return CountedMatrix(self.solver.linearise(problem, u), self._add)

    def _add(self) -> None:
        self.count += 1


class CountedMatrix(NamedTuple):
    """A factored matrix that reports each use to the host."""

    matrix: Linear
    report: Callable[[], None]

    def apply(self, rows: Unknowns) -> Unknowns:
        """The solver's correction."""
        jax.debug.callback(self.report)
        return self.matrix.apply(rows)
