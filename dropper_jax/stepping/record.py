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


class Record(NamedTuple):
    """Lengths of the steps that a run accepts, for other runs that repeat them.

    A repeated step that does not converge, or whose error is gross, is divided: a rope of a changed run that snaps
    where the recorded one hangs still would gain energy without bound.

    Attributes:
        length: of the steps (most,) [s]. A run of more steps is not recorded: `number` reaches `most`, and each
            further step replaces the last length.
        number: of steps so far.
        repeats: whether the run takes these steps in place of its own.
        part: of a repeated step, what is done [s].
    """

    length: Array
    number: Array
    repeats: Array
    part: Array

    @classmethod
    def empty(cls, model: Model, most: int = MOST_STEPS) -> Record:
        """The record of a run that starts and chooses its steps."""
        return cls(
            length=jnp.zeros(most, model.dtype),
            number=jnp.zeros((), jnp.int32),
            repeats=jnp.zeros((), bool),
            part=jnp.zeros((), model.dtype),
        )

    def to_repeat(self) -> Record:
        """The record for a run that starts and takes the recorded steps."""
        return self._replace(number=jnp.zeros((), jnp.int32), repeats=jnp.ones((), bool))

    def next_length(self, control: Control, chosen: Array) -> Array:
        """The next step [s] in place of the chosen one; the chosen one beyond the end of the record."""
        left = self.length[self.number] - self.part
        divided = (self.part > 0.0) | control.rejected
        repeated = jnp.where(divided, jnp.minimum(control.wanted, left), left)
        return jnp.where(self.repeats & (left > 0.0), repeated, chosen)

    def with_step(self, h: Array, accepted: Array) -> Record:
        """The record after a step of h [s]."""
        now = self.length[self.number]
        length = jnp.where(accepted & ~self.repeats, h, now)
        lengths = jax.lax.dynamic_update_index_in_dim(self.length, length, self.number, axis=0)
        part = self.part + h
        whole = ~self.repeats | (part >= (1.0 - ROUNDING) * now)
        return Record(
            length=lengths,
            number=self.number + (accepted & whole),
            repeats=self.repeats,
            part=jnp.where(accepted, jnp.where(whole, 0.0, part), self.part),
        )
