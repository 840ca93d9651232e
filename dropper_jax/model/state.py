"""What a run carries from step to step."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from dropper_jax.base.fields import component
from dropper_jax.model.broken_links import Parted, nothing_parted
from dropper_jax.model.kinematics import Frozen
from dropper_jax.model.model import Model
from dropper_jax.model.work import work_names


@component
class State:
    """What a run carries from step to step.

    Attributes:
        r, v: free nodes (nodes, 3) [m], [m/s].
        tension: (n,) [N], the last step's, and the next one's first guess.
        t: time [s].
        acceleration: last step's change of velocity per time (nodes, 3) [m/s^2]; a first guess, but
            what generalized_alpha carries from step to step.
        law: unknowns of effects with laws of their own; a first guess only.
        work: work done since the start by each non-conservative contribution, see `work_names` (k,) [J].
        angles: polar and azimuth angles and rates, each (n,), for schemes that keep these instead (else None).
        parted: links that have broken, where the scene has failures (else None).
        own: what effects change as the run goes on (`slots.Stateful`), by effect.
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
    """A state from free-node positions (nodes, 3) [m] and velocities; what is not given is zero."""
    r = jnp.asarray(r, model.dtype)
    return State(
        r=r,
        v=jnp.zeros_like(r) if v is None else jnp.asarray(v, model.dtype),
        tension=jnp.zeros(model.line.links, model.dtype) if tension is None else jnp.asarray(tension, model.dtype),
        t=jnp.asarray(t, model.dtype),
        acceleration=jnp.zeros_like(r),
        law=model.no_multipliers(),
        work=jnp.zeros(len(work_names(model)), model.dtype),
        parted=nothing_parted(model),
        own=model.initial_internal_state(),
    )
