"""The residual of a step: unknowns, rows, and Newton's method on them."""

from dropper_jax.residual.newton import CONVERGED, damped_newton, newton, newton_until, refine
from dropper_jax.residual.problem import (
    GRAVITY_SCALE,
    CondensedParts,
    SpeedProblem,
    StepProblem,
    Unknowns,
    add,
    node_blocks,
)
from dropper_jax.residual.scheme import Explicit, Implicit, Integrator, Solver, couples_inertia, point_masses_only

__all__ = [
    "CondensedParts",
    "Explicit",
    "GRAVITY_SCALE",
    "Implicit",
    "Integrator",
    "CONVERGED",
    "Solver",
    "SpeedProblem",
    "StepProblem",
    "Unknowns",
    "add",
    "couples_inertia",
    "damped_newton",
    "newton",
    "newton_until",
    "node_blocks",
    "point_masses_only",
    "refine",
]
