"""The time integrators, one file each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dropper_jax.integrators.dop853 import Dop853
from dropper_jax.integrators.energy_momentum import EnergyMomentum
from dropper_jax.integrators.energy_momentum_4 import EnergyMomentum4
from dropper_jax.integrators.generalized_alpha import GeneralizedAlpha
from dropper_jax.integrators.rattle import Rattle
from dropper_jax.integrators.rattle_4 import Rattle4
from dropper_jax.integrators.rk2 import RK2
from dropper_jax.integrators.rk4 import RK4
from dropper_jax.integrators.semi_implicit_euler import SemiImplicitEuler
from dropper_jax.integrators.thesis_angles import ThesisAngles
from dropper_jax.integrators.theta import Theta
from dropper_jax.integrators.theta_midpoint import ThetaMidpoint
from dropper_jax.integrators.tsit5 import Tsit5

INTEGRATORS = {
    cls.name: cls
    for cls in (
        EnergyMomentum,
        Rattle,
        Theta,
        ThetaMidpoint,
        SemiImplicitEuler,
        RK2,
        RK4,
        EnergyMomentum4,
        Rattle4,
        GeneralizedAlpha,
        Tsit5,
        Dop853,
        ThesisAngles,
    )
}


def _options() -> dict[str, Mapping[str, Any]]:
    """Meaning and widest range of every option of a scheme, by name."""
    found: dict[str, Mapping[str, Any]] = {}
    for scheme in INTEGRATORS.values():
        for name, one in scheme.options().items():
            other = found.get(name, one)
            low, high = min(one["low"], other["low"]), max(one["high"], other["high"])
            found[name] = {**one, "low": low, "high": high, "open_low": one["open_low"] and other["open_low"]}
    return found


#: Keys that `[run]` may contain in addition to its own; each scheme checks its own range.
OPTIONS = _options()

__all__ = ["INTEGRATORS", "OPTIONS"]
