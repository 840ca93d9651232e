"""The time integrators, one file each, imported when one of them is first needed: a help text needs no JAX."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dropper_jax.residual import Integrator

#: Class of each scheme, in the module of the scheme's name.
SCHEMES = {
    "energy_momentum": "EnergyMomentum",
    "rattle": "Rattle",
    "theta": "Theta",
    "theta_midpoint": "ThetaMidpoint",
    "semi_implicit_euler": "SemiImplicitEuler",
    "rk2": "RK2",
    "rk4": "RK4",
    "energy_momentum_4": "EnergyMomentum4",
    "rattle_4": "Rattle4",
    "generalized_alpha": "GeneralizedAlpha",
    "tsit5": "Tsit5",
    "dop853": "Dop853",
    "thesis_angles": "ThesisAngles",
}

#: Class of each scheme by name.
INTEGRATORS: dict[str, type[Integrator]]
#: Keys that `[run]` may contain in addition to its own; each scheme checks its own range.
OPTIONS: dict[str, Mapping[str, Any]]

__all__ = ["INTEGRATORS", "OPTIONS", "SCHEMES"]


def __getattr__(name: str) -> Mapping[str, Any]:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    schemes = {scheme: getattr(import_module(f"{__name__}.{scheme}"), cls) for scheme, cls in SCHEMES.items()}
    globals().update(INTEGRATORS=schemes, OPTIONS=_options(schemes))
    return globals()[name]


def _options(schemes: Mapping[str, type[Integrator]]) -> dict[str, Mapping[str, Any]]:
    """Meaning and widest range of every option of a scheme, by name."""
    found: dict[str, Mapping[str, Any]] = {}
    for scheme in schemes.values():
        for name, one in scheme.options().items():
            other = found.get(name, one)
            low = min(one["low"], other["low"])
            high = max(one["high"], other["high"])
            found[name] = {**one, "low": low, "high": high, "open_low": one["open_low"] and other["open_low"]}
    return found
