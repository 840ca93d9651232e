"""The scheme used for windows."""

from __future__ import annotations

from dropper_jax.base.errors import SceneError
from dropper_jax.integrators.rattle_4 import Rattle4
from dropper_jax.model import Model
from dropper_jax.solvers import SOLVERS
from dropper_jax.stepping.choose import make_stepper
from dropper_jax.stepping.stepper import Stepper

#: Newton iterations of a rattle_4 stage: its Jacobian is exact, three reach rounding at 1/60 s (residual 8e-16).
ITERATIONS = 3


def choose_stepper(model: Model, integrator: str | None = None, solver: str = "auto") -> Stepper:
    """The scheme with the best ratio of cost to error: rattle_4 for point masses, otherwise energy_momentum.

    Args:
        solver: as in the scene's `run.solver`; `auto` uses `condensed` where it applies.

    Raises:
        SceneError: a solver that does not support this scene or scheme.
    """
    if integrator is None and Rattle4().refuse(model) is None:
        if solver != "auto" and (reason := SOLVERS[solver].refuse(model, Rattle4())):
            raise SceneError(f"run.solver: {solver!r} cannot serve this fit: {reason}")
        settings = {"extra": 0, "halvings": 0, "track_work": False, "reverse": False, "batched": True}
        return Stepper(Rattle4(), "condensed" if solver == "auto" else solver, "banded", ITERATIONS, **settings)
    # No halving: a window whose steps do not solve means that the fit's step was too long; it then tries a shorter one.
    # Sticking joints are different: only the last fallback finds which of them stick, on the whole step or on half of
    # it, and an unsolved step has an unbounded derivative (measured on three links: 1e20).
    settings = {"halvings": 1} if model.laws else {"halvings": 0, "extra": 0}
    return make_stepper(
        model, integrator or "energy_momentum", solver, track_work=False, reverse=False, **settings
    )  # all derivatives of a fit use forward mode
