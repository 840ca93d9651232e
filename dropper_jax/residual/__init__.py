"""A step is a residual: its unknowns and rows, Newton's method on them, the derivative of the solution (`step`)."""

from dropper_jax.residual.newton import Filter, Linear, Newton, Solver, largest_row, newton, subtract
from dropper_jax.residual.problem import (
    GRAVITY_SCALE,
    DisplacementProblem,
    NodeRows,
    PerLaw,
    SpeedProblem,
    StepProblem,
    Unknowns,
)
from dropper_jax.residual.scheme import (
    Embedded,
    Explicit,
    Implicit,
    Integrator,
    LocalError,
    couples_inertia,
    point_masses_only,
)
from dropper_jax.residual.step import TOO_FAR, Stepper, explicit_row, step, step_and_filter

__all__ = [
    "DisplacementProblem",
    "Embedded",
    "Explicit",
    "Filter",
    "GRAVITY_SCALE",
    "Implicit",
    "Integrator",
    "Linear",
    "LocalError",
    "Newton",
    "NodeRows",
    "PerLaw",
    "Solver",
    "SpeedProblem",
    "StepProblem",
    "Stepper",
    "TOO_FAR",
    "Unknowns",
    "couples_inertia",
    "explicit_row",
    "largest_row",
    "newton",
    "point_masses_only",
    "step",
    "step_and_filter",
    "subtract",
]
