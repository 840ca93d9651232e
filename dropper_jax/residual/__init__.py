"""The residual of a step: unknowns, rows, and Newton's method on them."""

from dropper_jax.residual.newton import CONVERGED, damped_newton, newton, newton_until, refine
from dropper_jax.residual.problem import GRAVITY_SCALE, CondensedParts, StepProblem, node_blocks
from dropper_jax.residual.scheme import Explicit, Implicit, Integrator, couples_inertia, point_masses_only
from dropper_jax.residual.solver import Solver
from dropper_jax.residual.unknowns import Unknowns, add

__all__ = [
    "CondensedParts",
    "Explicit",
    "GRAVITY_SCALE",
    "Implicit",
    "Integrator",
    "CONVERGED",
    "Solver",
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
