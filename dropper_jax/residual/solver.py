"""Interface of linear solvers for Newton corrections."""

from __future__ import annotations

from typing import Protocol, TypeVar

from dropper_jax.model import Model
from dropper_jax.residual.problem import StepProblem
from dropper_jax.residual.scheme import Implicit
from dropper_jax.residual.unknowns import Unknowns

Factors = TypeVar("Factors")
Prepared = TypeVar("Prepared")


class Solver(Protocol[Prepared, Factors]):
    """The matrix may be approximate; Newton and derivatives are refined to the exact rows."""

    name: str

    def refuse(self, model: Model, integrator: Implicit) -> str | None:
        """Why it cannot solve the model with a scheme, or None."""

    def prepare(self, problem: StepProblem, u: Unknowns) -> Prepared:
        """Data reused in the iterations of a step."""

    def factor(self, problem: StepProblem, u: Unknowns, prepared: Prepared | None = None) -> Factors:
        """The factored matrix at the unknowns."""

    def apply(self, factor: Factors, rows: Unknowns) -> Unknowns:
        """The correction for given rows."""

    def apply_transposed(self, factor: Factors, rows: Unknowns) -> Unknowns:
        """The solution with the transposed matrix."""
