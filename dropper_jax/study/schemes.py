"""Schemes that are compared: integrators with their weight, solver and precision."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dropper_jax.base.errors import SceneError
from dropper_jax.integrators import INTEGRATORS
from dropper_jax.model import Model
from dropper_jax.residual import Stepper
from dropper_jax.stepping.stepper import make_stepper

#: Schemes with a weight gamma, and the default weights of a comparison.
SCHEME_WEIGHTS = {"theta": (0.51, 1.0), "theta_midpoint": (0.51,), "thesis_angles": (0.51,)}
#: Further solvers and precisions of the main schemes.
SOLVERS = {"energy_momentum": ("banded", "dense")}
SINGLE = ("energy_momentum", "rattle")
#: Schemes compared in waves.
IN_WAVES = ("energy_momentum", "rattle", "theta_midpoint", "rk4", "energy_momentum_4", "generalized_alpha")


@dataclass(frozen=True)
class Scheme:
    """An integrator with its weight, solver and precision."""

    integrator: str
    gamma: float | None = None
    solver: str = "auto"
    dtype: str = "float64"

    @classmethod
    def with_default_weight(cls, name: str) -> Scheme:
        """An integrator with the first of its default weights."""
        return cls(name, SCHEME_WEIGHTS.get(name, (None,))[0])

    @property
    def label(self) -> str:
        """Name for tables and legends."""
        weight = "" if self.gamma is None else f"{self.gamma:g}"
        parts = (self.integrator, weight, self.solver, self.dtype)
        return " ".join(part for part in parts if part not in ("", "auto", "float64"))

    def stepper(self, model: Model, **settings: object) -> Stepper:
        """Raises `SceneError` if the scheme cannot run the model."""
        return make_stepper(model, self.integrator, self.solver, gamma=self.gamma, **settings)


def parse(text: str) -> Scheme:
    """A scheme from `NAME`, or `NAME:GAMMA` such as `theta:0.51`."""
    name, _, weight = text.strip().partition(":")
    if name not in INTEGRATORS:
        raise SceneError(f"--integrators: {name!r} is unknown; allowed: {', '.join(INTEGRATORS)}, with :GAMMA")
    if not weight:
        return Scheme.with_default_weight(name)
    try:
        return Scheme(name, float(weight))
    except ValueError:
        raise SceneError(f"--integrators: {text!r}: {weight!r} is not a number; allowed: NAME or NAME:GAMMA") from None


def default_schemes(model: Model, quick: bool) -> list[Scheme]:
    """Every integrator; the main ones also with every solver and in single precision, unless `quick`.

    In waves one of each kind: a step costs 50 times as much there, and the others are known from calm scenes.
    """
    if model.sea is not None and model.sea.waves is not None:
        return list(map(Scheme.with_default_weight, IN_WAVES))
    found = []
    for name in INTEGRATORS:
        plain = [Scheme(name, gamma) for gamma in SCHEME_WEIGHTS.get(name, (None,))]
        found += plain
        if quick:
            continue
        found += [replace(plain[0], solver=solver) for solver in SOLVERS.get(name, ())]
        if name in SINGLE:
            found.append(replace(plain[0], dtype="float32"))
    return found


def runnable(schemes: Sequence[Scheme], model: Model) -> tuple[list[Scheme], list[dict[str, str]]]:
    """The schemes that can run the model, and the others with their reasons."""
    good = []
    refused = []
    for scheme in schemes:
        try:
            scheme.stepper(model)
            good.append(scheme)
        except SceneError as error:
            refused.append({"scheme": scheme.label, "reason": str(error)})
    return good, refused
