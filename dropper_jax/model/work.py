"""The ledger of work: all contributions to work that the energies do not contain, by name.

Effects, axial laws and moving ends declare the names of their work, and return it as tables `{name: scalar}`. Schemes
add these up and record them. No other code keeps a list.
"""

from __future__ import annotations

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from dropper_jax.model.model import MOVING_ENDS, Model
from dropper_jax.model.slots import AddedMass

Works = Mapping[str, jax.Array]
#: Name of the energy lost with broken links.
BREAKING = "breaking"


def work_names(model: Model) -> tuple[str, ...]:
    """Names of the entries of `State.work`, in order: non-conservative effects, laws, turning added mass, the axial
    law, moving ends, broken links."""
    names = [effect.name for effect in model.working]
    names += [law.name for law in model.laws if law.name not in names]
    names += [turning(effect) for effect in model.having(AddedMass)]
    names += model.line.axial.work_names
    if model.moving:
        names.append(MOVING_ENDS)
    if model.line.failures is not None:
        names.append(BREAKING)
    return tuple(names)


def turning(effect: AddedMass) -> str:
    """The name under which the work of turning added mass is recorded."""
    return f"{effect.name}_turning"


def book_works(model: Model, *tables: Works) -> jax.Array:
    """Tables of work [J] (or power) as the array (k,) with the order of `work_names`; missing entries are zero.

    Raises:
        ValueError: a table contains a name that is not in the ledger.
    """
    names = work_names(model)
    strangers = sorted({name for table in tables for name in table} - set(names))
    if strangers:
        raise ValueError(f"{strangers[0]!r} is not in the ledger of work; allowed: {', '.join(names) or 'nothing'}")
    found = [[table[name] for table in tables if name in table] for name in names]
    return jnp.stack([sum(same[1:], same[0]) if same else jnp.zeros((), model.dtype) for same in found])
