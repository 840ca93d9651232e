"""The parts of the matrix of a step that come from each link's own vector and tension."""

from __future__ import annotations

from typing import NamedTuple

from jax import Array

from dropper_jax.base.numerics import local_jacobian
from dropper_jax.residual import StepProblem, Unknowns


class LinkParts(NamedTuple):
    """Derivatives of `StepProblem.link_rows`, the force of each link and its axial law.

    Attributes:
        turn: force by the link vector (n, 3, 3).
        force: force by the tension (n, 3).
        gradient: law by the link vector (n, 3).
        compliance: law by the tension (n,), minus the link's compliance.
    """

    turn: Array
    force: Array
    gradient: Array
    compliance: Array

    @classmethod
    def of(cls, problem: StepProblem, u: Unknowns) -> LinkParts:
        """From four directions of forward mode."""
        d = problem.link_vectors(u.x)
        turn, gradient = local_jacobian(lambda d: problem.link_rows(d, u.y), d)
        force, law = local_jacobian(lambda y: problem.link_rows(d, y), u.y)
        return cls(turn, force, gradient, law)

    def transpose(self) -> LinkParts:
        turn, force, gradient, compliance = self
        return LinkParts(turn.mT, gradient, force, compliance)
