"""Observed quantities of the state of a run at one instant."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.numerics import safe_norm
from dropper_jax.integrators.consistent_velocities import make_consistent
from dropper_jax.model import Frozen, Model, Parted, State, as_parted, state


class Observed(NamedTuple):
    """One instant as reported: all nodes' positions and velocities (n + lines, 3), energies [J], length error [m]."""

    positions: Array
    velocities: Array
    kinetic: Array
    potential: Array
    closure: Array


def consistent_velocity(model: Model, s: State) -> Array:
    """Velocities (nodes, 3) [m/s] projected to the constraints, about which those of a midpoint scheme oscillate
    slightly.

    For output, restart and hand-over only: a projection inside the steps would dissipate energy.
    """
    if model.line.axial.elastic:
        return s.v
    return make_consistent(model.kinematics(s.r, s.v, s.t))[0]


def observe(
    model: Model,
    r: Array,
    v: Array,
    t: Array,
    parted: Parted | None = None,
    internal: Mapping[str, Frozen] | None = None,
) -> Observed:
    """Observe one instant; energies are those of the raw velocities, which the scheme conserves."""
    model = as_parted(model, parted).with_internal_state(internal or {}).with_lengths(t)
    k = model.instant(r, v, t)
    line = model.line
    rigid = np.flatnonzero(line.axial.rigid(line.links))
    closure = jnp.max(jnp.abs(safe_norm(k.links) - line.length)[rigid], initial=0.0)
    return Observed(
        positions=k.nodes,
        velocities=model.geometry.nodes(consistent_velocity(model, state(model, r, v, t=t)), k.ends.velocities),
        kinetic=model.kinetic_energy(k),
        potential=model.potential_energy(k),
        closure=closure,
    )
