"""Between two steps of different length: rates along rigid links that suit the next one, and the energy that they take.

See `integrators.consistent_velocities.velocities_after_step_change`.
"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.model import Model, State, as_parted
from dropper_jax.residual import Stepper

#: Name under which the energy of changes of the step is booked.
STEP_CHANGES = "step_changes"
#: Relative difference of two lengths of steps that are the same.
SAME = 1e-9


def with_step_changed(stepper: Stepper, model: Model, s: State, before: Array, h: Array) -> tuple[State, Array]:
    """The state from which a step of h [s] continues smoothly after one of `before` [s], 0 if there is none, and the
    energy that this adds [J]."""
    none = jnp.zeros((), model.dtype)
    if not _changes(stepper, model):
        return s, none
    inner = as_parted(model, s.parted).with_internal_state(s.own)

    def change() -> tuple[Array, Array]:
        v = stepper.integrator.change_step(inner, s, h).v
        if not stepper.track_work:
            return v, none
        k = inner.kinematics(s.r, s.v, s.t)
        return v, inner.kinetic_energy(k.with_velocity(v)) - inner.kinetic_energy(k)

    is_other = (before > 0.0) & (jnp.abs(h - before) > SAME * h)
    v, added = jax.lax.cond(is_other, change, lambda: (s.v, none))
    return replace(s, v=v), added


def books_changes(stepper: Stepper, model: Model) -> bool:
    """Whether the rows of a run have the energy of changes of the step as their last work."""
    return stepper.track_work and _changes(stepper, model)


def _changes(stepper: Stepper, model: Model) -> bool:
    """Whether velocities of the scheme depend on the step: it is implicit, and a link is inextensible."""
    return stepper.integrator.implicit and bool(model.line.axial.rigid(model.line.links).any())
