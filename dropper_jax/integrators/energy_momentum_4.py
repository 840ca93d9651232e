"""Fourth-order symmetric composition of the energy-momentum scheme, for reference solutions."""

from __future__ import annotations

from dataclasses import dataclass

from dropper_jax.integrators.energy_momentum import EnergyMomentum

#: Suzuki (1990): five steps p, p, 1 - 4p, p, p; smaller error constant than the three-step composition.
_P = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))


@dataclass(frozen=True)
class EnergyMomentum4(EnergyMomentum):
    """Five energy-momentum steps per step, the middle one backwards; fourth order, with the same conserved
    quantities. Axial vibrations that its steps do not resolve are not damped."""

    name = "energy_momentum_4"
    order = 4
    #: Backwards, friction solved as a law would drive the motion: a dry pendulum lost 2.3 times the correct energy.
    takes_laws = False
    stages = (_P, _P, 1.0 - 4.0 * _P, _P, _P)
    tension_time = 1.0 - 0.5 * _P
