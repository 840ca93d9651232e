"""The state that a run carries from step to step: positions and velocities, broken links, the ledger of work.

The ledger lists all work that the energies do not contain, by name. Effects, axial laws and moving ends declare the
names of their work, and return it as tables `{name: scalar}`. Schemes add these up and record them.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from dropper_jax.axial import LENGTH_IN_TIME, Works, sum_works
from dropper_jax.base.fields import component, option
from dropper_jax.model.kinematics import Frozen
from dropper_jax.model.model import MOVING_ENDS, Model
from dropper_jax.model.slots import AddedMass, LengthOverTime

#: Name of the energy lost with broken links.
BREAKING = "breaking"


def work_names(model: Model) -> tuple[str, ...]:
    """Names of the entries of `State.work`, in order: non-conservative effects, laws, turning added mass, the axial
    law, changing lengths, moving ends, broken links."""
    names = [effect.name for effect in model.working]
    names += [law.name for law in model.laws if law.name not in names]
    names += [turning(effect) for effect in model.having(AddedMass)]
    names += model.line.axial.work_names
    if model.having(LengthOverTime):
        names.append(LENGTH_IN_TIME)
    if model.moving:
        names.append(MOVING_ENDS)
    if model.line.failures is not None:
        names.append(BREAKING)
    return tuple(names)


def turning(effect: AddedMass) -> str:
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


@component
class Parted:
    """What has broken so far, by entry (m,): the link's index (-1: none), when [s], and the tension then [N]."""

    link: Array
    t: Array
    tension: Array


def nothing_parted(model: Model) -> Parted | None:
    """No broken links, as at the start of a run; None for a model in which nothing can break."""
    failures = model.line.failures
    if failures is None:
        return None
    zero = jnp.zeros(len(failures.named), model.dtype)
    return Parted(jnp.full(zero.shape, -1, jnp.int32), zero, zero)


def as_parted(model: Model, parted: Parted | None) -> Model:
    """The model with zero tension in broken links."""
    if parted is None:
        return model
    broken = jnp.any(parted.link[:, None] == jnp.arange(model.line.links), axis=0)
    return model.with_axial(model.line.axial.with_broken_links(1.0 - broken.astype(model.dtype)))


@component
class State:
    """The state that a run carries from step to step.

    Attributes:
        r, v: free nodes (nodes, 3) [m], [m/s].
        tension: (n,) [N], that of the last step, and the first guess of the next one.
        t: time [s].
        acceleration: change of velocity per time over the last step (nodes, 3) [m/s^2]: a first guess, and part of the
            state in energy_momentum, for lines that stretch, and in generalized_alpha.
        law: unknowns of effects with their own laws; a first guess only.
        work: work done since the start by each non-conservative contribution, see `work_names` (k,) [J].
        angles: polar and azimuth angles and rates, each (n,), for schemes that use these instead (else None).
        parted: broken links, if the scene has failures (else None).
        own: internal states that effects change during the run (`slots.Stateful`), by effect.
        carries_acceleration: whether `acceleration` is that at time t, and not a first guess (static).
    """

    r: Array
    v: Array
    tension: Array
    t: Array
    acceleration: Array
    law: tuple[Array, ...]
    work: Array
    angles: tuple[Array, ...] | None = None
    parted: Parted | None = None
    own: dict[str, Frozen] = dataclasses.field(default_factory=dict)
    carries_acceleration: bool = option("whether `acceleration` is that at the start of the step", default=False)


def state(
    model: Model, r: ArrayLike, v: ArrayLike | None = None, tension: ArrayLike | None = None, t: ArrayLike = 0.0
) -> State:
    """A state from free-node positions (nodes, 3) [m] and velocities; omitted values are zero.

    Raises:
        ValueError: an array of another shape.
    """

    def array(value: ArrayLike | None, *shape: int) -> Array:
        if value is None:
            value = np.zeros(shape)  # of NumPy: outside of a program `jnp.zeros` compiles one for each shape
        values = jnp.asarray(value, model.dtype)
        if values.shape != shape:
            raise ValueError(f"state: has an array of the shape {values.shape}; allowed: {shape} for this model")
        return values

    at_nodes = (model.free_nodes, 3)
    return State(
        r=array(r, *at_nodes),
        v=array(v, *at_nodes),
        tension=array(tension, model.line.links),
        t=array(t),
        acceleration=array(None, *at_nodes),
        law=model.no_multipliers(),
        work=array(None, len(work_names(model))),
        parted=nothing_parted(model),
        own=model.initial_internal_state(),
    )
