"""The ledger of work: all work that the energies do not contain, by name.

Effects, axial laws and moving ends declare the names of their work, and return it as tables `{name: scalar}`. Schemes
add these up and record them in `State.work`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.axial import LENGTH_IN_TIME, Works, sum_works
from dropper_jax.model.kinematics import Ends, Kinematics
from dropper_jax.model.model import Model
from dropper_jax.model.slots import AddedMass, ElementForce, Force, LengthOverTime, Potential

#: Name of the work of moving ends.
MOVING_ENDS = "moving_ends"
#: Name of the energy lost with broken links.
BREAKING = "breaking"


def work_names(model: Model) -> tuple[str, ...]:
    """Names of the entries of `State.work`, in order: non-conservative effects, laws, turning added mass, the axial
    law, changing lengths, moving ends, broken links."""
    names = [effect.name for effect in _non_conservative_effects(model)]
    names += [law.name for law in model.laws if law.name not in names]
    names += [turning_work_name(effect) for effect in model.effects_with(AddedMass)]
    names += model.line.axial.work_names
    if model.effects_with(LengthOverTime):
        names.append(LENGTH_IN_TIME)
    if model.has_moving_ends:
        names.append(MOVING_ENDS)
    if model.line.failures is not None:
        names.append(BREAKING)
    return tuple(names)


def turning_work_name(effect: AddedMass) -> str:
    """The name under which the work of turning added mass is recorded."""
    return f"{effect.name}_turning"


def book_works(model: Model, *tables: Works) -> Array:
    """Tables of work [J] (or power) as the array (k,) with the order of `work_names`; missing entries are zero.

    Raises:
        ValueError: a table contains a name that is not in the ledger.
    """
    names = work_names(model)
    found = sum_works(tables)
    strangers = sorted(found.keys() - set(names))
    if strangers:
        raise ValueError(f"{strangers[0]!r} is not in the ledger of work; allowed: {', '.join(names) or 'nothing'}")
    for name in names:
        if name not in found:
            found[name] = jnp.zeros((), model.dtype)
    return jnp.stack([found[name] for name in names])


def _non_conservative_effects(model: Model) -> list[Force]:
    """The effects whose force has no potential, so that its work is recorded."""
    return [effect for effect in model.effects_with(Force) if not isinstance(effect, Potential)]


def non_conservative_forces(model: Model, k: Kinematics) -> dict[str, Array]:
    """Forces (nodes, 3) [N] whose work is recorded, by effect."""
    return {effect.name: effect.force(k) for effect in _non_conservative_effects(model)}


def end_powers(model: Model, link_force: Array, ends: Ends, k: Kinematics | None = None) -> dict[str, Array]:
    """Power [W], by name, that moving ends put into `link_force` (n, 3) [N]; empty if the ends are at rest.

    With an instant k also the power into potentials that couple nodes, as for lines with bending stiffness.
    """
    if ends.velocities is None:
        return {}
    power = -jnp.sum(model.geometry.held_force(link_force) * ends.velocities)
    bent = [effect for effect in model.effects_with(Potential) if isinstance(effect, ElementForce)]
    if k is None or not bent:
        return {MOVING_ENDS: power}

    def stored_energy(positions: Array) -> Array:
        moved = model.kinematics(k.r, k.v, k.t, Ends(positions, ends.velocities))
        return sum((effect.potential(moved) for effect in bent), jnp.zeros((), model.dtype))

    return {MOVING_ENDS: power + jax.jvp(stored_energy, (ends.positions,), (ends.velocities,))[1]}
