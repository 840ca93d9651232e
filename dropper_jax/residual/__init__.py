"""A step is a residual: its unknowns and rows, Newton's method on them, the derivative of the solution (`step`)."""

from dropper_jax.residual.problem import GRAVITY_SCALE, SpeedProblem, StepProblem, local_jacobian
from dropper_jax.residual.scheme import Explicit, Implicit, Integrator, LocalError, couples_inertia, point_masses_only
from dropper_jax.residual.step import (
    TOO_FAR,
    Linear,
    Newton,
    Problem,
    Solver,
    Stepper,
    Unknowns,
    finish_step,
    largest_row,
    newton,
    solution,
    solve,
    step,
    subtract,
)

__all__ = [
    "Explicit",
    "GRAVITY_SCALE",
    "Implicit",
    "Integrator",
    "Linear",
    "LocalError",
    "Newton",
    "Problem",
    "Solver",
    "SpeedProblem",
    "StepProblem",
    "Stepper",
    "TOO_FAR",
    "Unknowns",
    "couples_inertia",
    "finish_step",
    "largest_row",
    "local_jacobian",
    "newton",
    "point_masses_only",
    "solution",
    "solve",
    "step",
    "subtract",
]
