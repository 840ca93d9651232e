"""Rules for choosing or rejecting the scheme and solver of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.integrators import INTEGRATORS, OPTIONS
from dropper_jax.model import Graph, Model
from dropper_jax.residual import Explicit, Implicit, Integrator
from dropper_jax.solvers import SOLVERS
from dropper_jax.stepping.stepper import Stepper

#: Maximum number of Newton corrections of a step of a system of lines; a step that needs more is halved.
SYSTEM_ITERATIONS = 16


#: Number of unknowns below which LU of the full Jacobian is faster than block elimination (measured at 3 compound
#: links).
SMALL = 16


def make_stepper(
    model: Model,
    integrator: str = "energy_momentum",
    solver: str = "auto",
    **settings: Any,
) -> Stepper:
    """Choose integrator and solver for a model; invalid combinations are rejected with the reason.

    `settings` are options of the scheme (gamma, rho_infinity; None for its default) and fields of `Stepper`
    (iterations, tolerance, extra, halvings, track_work). `auto` selects the condensed solver if it applies, else dense
    for few unknowns, else banded.
    """
    check_names(integrator, solver)
    options = {key: settings.pop(key) for key in OPTIONS if key in settings}
    scheme = make_scheme(integrator, options).form_for(model)
    reason = scheme.refuse(model)
    if reason:
        raise SceneError(f"run.integrator: {integrator!r} cannot run this scene: {reason}")
    if isinstance(scheme, Explicit):
        if solver != "auto":
            raise SceneError(f"run.solver: {solver!r} is given, but integrator {integrator!r} solves nothing; use auto")
        return Stepper(scheme, "none", "none", 0, **settings)
    if solver != "auto" and (reason := SOLVERS[solver].refuse(model, scheme)):
        raise SceneError(f"run.solver: {solver!r} cannot serve this scene: {reason}")
    chosen = _choose(model, scheme) if solver == "auto" else solver
    if isinstance(model.geometry, Graph):
        settings = {"iterations": SYSTEM_ITERATIONS, "until_converged": True, **settings}
        return Stepper(scheme, chosen, chosen, settings.pop("iterations"), **settings)
    iterations = settings.pop("iterations", None)
    if iterations is None:
        iterations = scheme.condensed_iterations if chosen == "condensed" else scheme.iterations
        if settings.get("extra") == 0:  # no later stage follows
            iterations = max(iterations, scheme.iterations)
    if model.laws:  # more iterations do not help: which joints stick must be determined first (`follow`)
        settings.setdefault("extra", 0)
    return Stepper(scheme, chosen, _exact(model, scheme), iterations, **settings)


def make_scheme(name: str, options: Mapping[str, float | None]) -> Integrator:
    """The scheme of this name with its options; None means its default.

    Raises:
        SceneError: an option that the scheme does not have or that is out of range.
    """
    cls = INTEGRATORS[name]
    given = {key: value for key, value in options.items() if value is not None}
    for key, value in given.items():
        if key not in cls.options():
            why = f"is given, but integrator {name!r} has no such weight. Leave it out"
            raise SceneError(f"run.{key}: {value} {why}")
    return cls(**{key: float(value) for key, value in given.items()})


def check_names(integrator: str, solver: str) -> None:
    """Reject unknown names."""
    if integrator not in INTEGRATORS:
        raise SceneError(f"run.integrator: {integrator!r} is unknown; {nearest(integrator, INTEGRATORS)}")
    if solver != "auto" and solver not in SOLVERS:
        raise SceneError(f"run.solver: {solver!r} is unknown; {nearest(solver, [*SOLVERS, 'auto'])}")


def _choose(model: Model, scheme: Implicit) -> str:
    return "condensed" if SOLVERS["condensed"].refuse(model, scheme) is None else _exact(model, scheme)


def _exact(model: Model, scheme: Implicit) -> str:
    if isinstance(model.geometry, Graph):
        return "dense" if SOLVERS["network"].refuse(model, scheme) else "network"
    if SOLVERS["banded"].refuse(model, scheme) is not None or SOLVERS["dense"].size(model) <= SMALL:
        return "dense"
    return "banded"
