"""The lengths of the steps that a run accepts, for other runs that repeat them."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.model import Model
from dropper_jax.stepping.halving import ROUNDING
from dropper_jax.stepping.step_control import Control

#: Maximum number of steps whose lengths a run records.
MOST_STEPS = 2**17


class StepRecord(NamedTuple):
    """Lengths of the steps of a run, which it records, or repeats in place of its own.

    A repeated step that does not converge, or whose error is gross, is divided: a rope of a changed run that snaps
    where the recorded one hangs still would gain energy without bound.

    Attributes:
        length: of the recorded steps (most,) [s], 0 after the last one. A run of more steps is not recorded: `number`
            reaches `most`, and each further step replaces the last length.
        number: of steps recorded or repeated so far, which is the index of the present one.
        repeats: whether the run repeats the steps; otherwise it records its own.
        part: time [s] of the present repeated step that is done, if it is divided; else 0.
    """

    length: Array
    number: Array
    repeats: Array
    part: Array

    @classmethod
    def empty(cls, model: Model, most: int = MOST_STEPS) -> StepRecord:
        """The record of a run that starts and chooses its steps."""
        return cls(
            length=jnp.zeros(most, model.dtype),
            number=jnp.zeros((), jnp.int32),
            repeats=jnp.zeros((), bool),
            part=jnp.zeros((), model.dtype),
        )

    def to_repeat(self) -> StepRecord:
        """The record for a run that starts and takes the recorded steps."""
        return self._replace(number=jnp.zeros((), jnp.int32), repeats=jnp.ones((), bool))

    def next_length(self, control: Control, chosen: Array) -> Array:
        """Length of the next step [s]: that of the record if it is repeated and has one, else the chosen one."""
        left = self.length[self.number] - self.part
        is_divided = (self.part > 0.0) | control.rejected
        repeated = jnp.where(is_divided, jnp.minimum(control.wanted, left), left)
        return jnp.where(self.repeats & (left > 0.0), repeated, chosen)

    def with_step(self, h: Array, accepted: Array) -> StepRecord:
        """The record after a step of h [s] was tried."""
        present = self.length[self.number]
        recorded = jnp.where(accepted & ~self.repeats, h, present)
        part = self.part + h
        is_whole = ~self.repeats | (part >= (1.0 - ROUNDING) * present)
        return StepRecord(
            length=jax.lax.dynamic_update_index_in_dim(self.length, recorded, self.number, axis=0),
            number=self.number + (accepted & is_whole),
            repeats=self.repeats,
            part=jnp.where(accepted, jnp.where(is_whole, 0.0, part), self.part),
        )
