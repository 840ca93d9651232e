"""Choice of scheme, solver and settings of a step; invalid combinations are rejected with the reason."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.integrators import INTEGRATORS, OPTIONS
from dropper_jax.model import Model
from dropper_jax.residual import Implicit, Integrator, Solver, Stepper
from dropper_jax.solvers import SOLVERS, Dense

#: Number of unknowns up to which LU of the full Jacobian is faster than block elimination (measured at 3 compound
#: links).
FEW_UNKNOWNS = 16
#: Settings of Newton's method for one line: corrections down to rounding, so that energy is conserved. Most steps need
#: four to six.
OF_A_LINE = {"iterations": 40, "renew": 0.3}
#: For systems of lines, whose ropes go slack and touch the seabed: most steps need three corrections, each with a
#: matrix of its own, those with a switch up to a dozen. A kept matrix diverges there.
OF_A_SYSTEM = {"iterations": 24, "enough": 1.0, "least": 0, "renew": 0.0, "shortened": 3}
#: For set-valued laws: near rounding, so that sticking joints do not creep. More corrections do not help: which joints
#: stick must be determined first (`residual.newton.solve_smoothed`).
OF_LAWS = {"iterations": 8, "enough": 1e-3, "renew": 0.0}
#: How often a step that does not converge is halved.
HALVINGS = 6


def make_stepper(
    model: Model,
    integrator: str = "energy_momentum",
    solver: str = "auto",
    **settings: Any,
) -> Stepper:
    """Choose integrator and solver for a model; invalid combinations are rejected with the reason.

    Args:
        solver: `auto` selects the condensed solver if it applies, else network for systems, dense for few unknowns,
            else banded.
        settings: options of the scheme (gamma, rho_infinity; None for its default) and fields of `Stepper`.

    Raises:
        SceneError: an unknown name, or what the scheme or the solver cannot run.
    """
    check_names(integrator, solver)
    check_settings(settings, [*OPTIONS, *stepper_settings()])
    _check_numbers(settings)
    options = {key: settings.pop(key) for key in OPTIONS if key in settings}
    scheme = make_scheme(integrator, options).form_for(model)
    reason = scheme.refuse(model)
    if reason:
        raise SceneError(f"run.integrator: {integrator!r} cannot run this scene: {reason}")
    if not isinstance(scheme, Implicit):
        if solver != "auto":
            raise SceneError(f"run.solver: {solver!r} is given, but integrator {integrator!r} solves nothing; use auto")
        if settings.pop("iterations", None) is not None:
            raise SceneError(f"iterations: are given, but integrator {integrator!r} solves nothing. Leave them out")
        return Stepper(integrator=scheme, solver=None, **settings)
    if solver == "auto":
        chosen = choose_solver(model, scheme)
    else:
        chosen = SOLVERS[solver]
        if reason := chosen.refuse(model, scheme):
            raise SceneError(f"run.solver: {solver!r} cannot serve this scene: {reason}")
    return Stepper(integrator=scheme, solver=chosen, **{**newton_settings(model, scheme), **settings})


def _check_numbers(settings: Mapping[str, Any]) -> None:
    """Reject numbers of Newton's method that are out of range."""
    for name, low, allowed in (("iterations", 1, "1 or more corrections"), ("halvings", 0, "0 or more halvings")):
        value = settings.get(name)
        if value is not None and not (isinstance(value, int | np.integer) and value >= low):
            raise SceneError(f"{name}: {value!r} is out of range; allowed: {allowed}")
    tolerance = settings.get("tolerance")
    if tolerance is not None and not 0.0 <= tolerance < np.inf:
        raise SceneError(f"residual_tolerance: {tolerance!r} is out of range; allowed: a number >= 0")


def newton_settings(model: Model, scheme: Implicit) -> dict[str, Any]:
    """How corrections of a step are counted for a model and a scheme, as fields of `Stepper`."""
    if not model.geometry.is_path:
        found = dict(OF_A_SYSTEM)
        if str(model.dtype) == "float32":  # a guess may be within the tolerance, and a line would not move
            found["least"] = 2
    elif model.laws:
        found = dict(OF_LAWS)
    else:
        found = {**OF_A_LINE, "enough": scheme.enough}
    found["easing"] = any(not law.node_local for law in model.laws)
    found["halvings"] = HALVINGS
    return found


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
    if solver not in ("auto", *SOLVERS):
        raise SceneError(f"run.solver: {solver!r} is unknown; {nearest(solver, [*SOLVERS, 'auto'])}")


def choose_solver(model: Model, scheme: Implicit) -> Solver:
    """The fastest solver that takes the model and the scheme."""
    is_small = Dense().size(model) <= FEW_UNKNOWNS
    for name in ("condensed", "network", "banded"):
        if SOLVERS[name].refuse(model, scheme) is None and not (name == "banded" and is_small):
            return SOLVERS[name]
    return SOLVERS["dense"]


def check_settings(settings: Iterable[str], known: Iterable[str]) -> None:
    """Reject unknown keywords of the functions that pass their further settings to `make_stepper`."""
    known = list(known)
    for name in settings:
        if name not in known:
            raise SceneError(f"{name}: unknown setting; {nearest(name, known)}")


def stepper_settings() -> list[str]:
    """Names of the fields of `Stepper` that can be set; integrator and solver are chosen by their names."""
    return [field.name for field in fields(Stepper) if field.name not in ("integrator", "solver")]
