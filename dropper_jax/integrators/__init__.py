"""The time integrators, one file each, imported when one of them is first needed: a help text needs no JAX."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from dropper_jax.base.records import column
from dropper_jax.base.registry import Registry

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

#: Schemes that take an option of `[run]`, by the option's name.
TAKERS = {
    "gamma": ("theta", "theta_midpoint", "thesis_angles"),
    "rho_infinity": ("generalized_alpha",),
}


class Options(Mapping[str, Mapping[str, Any]]):
    """Meaning and widest range of every option of a scheme, by name; each scheme checks its own range."""

    def __getitem__(self, name: str) -> Mapping[str, Any]:
        declared = [INTEGRATORS[scheme].options()[name] for scheme in TAKERS[name]]
        # at least one of the schemes includes its lowest value
        low = min(one["low"] for one in declared if one["above"] is None)
        return {**declared[-1], "low": low, "above": None, "high": max(column(declared, "high"))}

    def __iter__(self) -> Iterator[str]:
        return iter(TAKERS)

    def __len__(self) -> int:
        return len(TAKERS)


#: Class of each scheme by name.
INTEGRATORS: Registry[type[Integrator]] = Registry(
    {scheme: f"{__name__}.{scheme}:{cls}" for scheme, cls in SCHEMES.items()}
)
#: Keys that `[run]` may contain in addition to its own.
OPTIONS = Options()

__all__ = ["INTEGRATORS", "OPTIONS", "SCHEMES"]
