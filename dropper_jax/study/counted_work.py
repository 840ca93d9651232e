"""Counted work of a step: numbers that do not depend on the load of the machine, as measured times do."""

from __future__ import annotations

import jax
from jax import Array

from dropper_jax.model import Model, State
from dropper_jax.stepping.stepper import Stepper

#: Operations per unknown of a linear solve by elimination in small blocks, and per sine, root or exponential.
PER_UNKNOWN = 100.0
PER_FUNCTION = 20.0


def evaluation_work(model: Model, s: State) -> float:
    """Operations of one evaluation of the forces, as the compiler counts them, and of a solve with all unknowns."""
    counts = jax.jit(_forces).lower(model, s).cost_analysis() or {}
    functions = PER_FUNCTION * counts.get("transcendentals", 0.0)
    return counts.get("flops", 0.0) + functions + PER_UNKNOWN * unknowns(model)


def _forces(model: Model, s: State) -> Array:
    return model.force(model.instant(s.r, s.v, s.t))


def unknowns(model: Model) -> int:
    """Positions and tensions of a step."""
    return 3 * model.free_nodes + model.line.links


def step_work(model: Model, stepper: Stepper, evaluation: float) -> float:
    """Operations of a step: its evaluations, each with a solve; a dense Jacobian takes one per unknown."""
    columns = 1
    if stepper.solver_name == "dense":
        columns = unknowns(model)
    return columns * stepper.integrator.evaluations * evaluation
