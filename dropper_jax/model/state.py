"""The state that a run carries from step to step: positions and velocities, broken links, the ledger of work."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from dropper_jax.base.fields import component, option
from dropper_jax.model.kinematics import Frozen
from dropper_jax.model.model import Model
from dropper_jax.model.work import work_names


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
        law=_zero_multipliers(model),
        work=array(None, len(work_names(model))),
        parted=nothing_parted(model),
        own=model.initial_internal_state(),
    )


def _zero_multipliers(model: Model) -> tuple[Array, ...]:
    """Zeros in the shape of the unknowns of laws and constraints (`State.law`)."""
    laws = [np.zeros((law.rows(model), law.components)) for law in model.laws]
    constraints = [np.zeros(constraint.rows(model)) for constraint in model.constraints]
    return tuple(jnp.asarray(zeros, model.dtype) for zeros in (*laws, *constraints))
