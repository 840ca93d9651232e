"""The energy-momentum scheme with its configuration weighted by gamma: dissipative, one tension per step."""

from __future__ import annotations

from dataclasses import dataclass

from dropper_jax.base.fields import parameter
from dropper_jax.integrators.energy_momentum import EnergyMomentum


@dataclass(frozen=True)
class ThetaMidpoint(EnergyMomentum):
    """`r_gamma = (1 - gamma) r0 + gamma r1` for forces and tension directions, gamma from 0.5 to 1.

    One of the two schemes that "gamma = 0.51" may mean; the thesis' own is `theta`. Gamma = 0.5 is `energy_momentum`.
    Above it the scheme is first order, stable and dissipative.
    """

    name = "theta_midpoint"
    order = 1
    gamma: float = parameter("weight of the new time", unit="-", low=0.5, high=1.0, default=0.51)

    @property
    def dissipates(self) -> bool:
        return self.gamma > 0.5

    @property
    def weighting(self) -> float:
        return self.gamma
