"""The ledger of work: what does work that the energies do not hold, by name.

Effects, axial laws and moving ends say under which names they work, and return what they do as tables
`{name: scalar}`; schemes add these up and book them. Nobody else keeps a list.
"""

from __future__ import annotations

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from dropper_jax.model.model import MOVING_ENDS, Model
from dropper_jax.model.slots import AddedMass

Works = Mapping[str, jax.Array]
#: What parting links take with them.
BREAKING = "breaking"


def work_names(model: Model) -> tuple[str, ...]:
    """What `State.work` counts, in order: non-conservative effects, laws, turning added mass, the axial law, moving
    ends, broken links."""
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
    """The name under which turning added mass works."""
    return f"{effect.name}_turning"


def book_works(model: Model, *tables: Works) -> jax.Array:
    """Tables of work [J] (or power) as the array (k,) that `work_names` names; what no table names is zero.

    Raises:
        ValueError: a table names something that is not in the ledger.
    """
    names = work_names(model)
    strangers = sorted({name for table in tables for name in table} - set(names))
    if strangers:
        raise ValueError(f"{strangers[0]!r} is not in the ledger of work; allowed: {', '.join(names) or 'nothing'}")
    found = [[table[name] for table in tables if name in table] for name in names]
    return jnp.stack([sum(same[1:], same[0]) if same else jnp.zeros((), model.dtype) for same in found])
