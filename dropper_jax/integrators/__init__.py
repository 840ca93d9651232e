"""The time integrators, one file each, and the rules by which a run's choice is made or refused."""

from __future__ import annotations

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
        ThesisAngles,
    )
}

__all__ = ["INTEGRATORS"]
