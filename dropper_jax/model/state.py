"""The state that a run carries from step to step."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.fields import component
from dropper_jax.model.broken_links import Parted, nothing_parted
from dropper_jax.model.kinematics import Frozen
from dropper_jax.model.model import Model
from dropper_jax.model.work import work_names


@component
class State:
    """The state that a run carries from step to step.

    Attributes:
        r, v: free nodes (nodes, 3) [m], [m/s].
        tension: (n,) [N], that of the last step, and the first guess of the next one.
        t: time [s].
        acceleration: change of velocity per time over the last step (nodes, 3) [m/s^2]; a first guess, except in
            generalized_alpha, which carries it as part of its state.
        law: unknowns of effects with their own laws; a first guess only.
        work: work done since the start by each non-conservative contribution, see `work_names` (k,) [J].
        angles: polar and azimuth angles and rates, each (n,), for schemes that use these instead (else None).
        parted: broken links, if the scene has failures (else None).
        own: internal states that effects change during the run (`slots.Stateful`), by effect.
    """

    r: jax.Array
    v: jax.Array
    tension: jax.Array
    t: jax.Array
    acceleration: jax.Array
    law: tuple[jax.Array, ...]
    work: jax.Array
    angles: tuple[jax.Array, ...] | None = None
    parted: Parted | None = None
    own: dict[str, Frozen] = dataclasses.field(default_factory=dict)


def state(
    model: Model, r: jax.Array, v: jax.Array | None = None, tension: jax.Array | None = None, t: float = 0.0
) -> State:
    """A state from free-node positions (nodes, 3) [m] and velocities; omitted values are zero."""
    r = jnp.asarray(r, model.dtype)
    return State(
        r=r,
        v=jnp.asarray(np.zeros(r.shape, r.dtype)) if v is None else jnp.asarray(v, model.dtype),
        tension=jnp.asarray(np.zeros(model.line.links) if tension is None else tension, model.dtype),
        t=jnp.asarray(t, model.dtype),
        acceleration=jnp.asarray(np.zeros(r.shape, r.dtype)),
        law=model.no_multipliers(),
        work=jnp.zeros(len(work_names(model)), model.dtype),
        parted=nothing_parted(model),
        own=model.initial_internal_state(),
    )
