"""Extremes of quantities over all steps of a run that saves fewer states."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.fields import component, option
from dropper_jax.model import Model, State
from dropper_jax.quantities.quantities import Quantity
from dropper_jax.quantities.statistics import OVER_STEPS
from dropper_jax.stepping.extremes import Extremes


@component
class QuantitySignals:
    """Signals (n + q,) of a step whose extremes over all steps a run keeps: tensions of the links, and quantities.

    Quantities are maxima and minima; each has the extreme of its members. Without the parabola of `STATISTICS`, a
    maximum is that of the steps. See `stepping.extremes`.
    """

    start: Array
    quantities: tuple[Quantity, ...] = option("maxima and minima")

    def __call__(self, model: Model, before: State, after: State) -> tuple[Array, Array]:
        now = after.r, after.v, after.tension, after.t, after.parted
        found = [OVER_STEPS[one.statistic](one.instant(model, self.start, *now))[None] for one in self.quantities]
        return jnp.concatenate([after.tension, *found]), after.t

    def over_steps(self, extremes: Extremes) -> dict[Quantity, Array]:
        """The extreme of each quantity since the last saved time (k,), from rows (k, n + q)."""
        sides = {"max": extremes.largest, "min": extremes.least}
        first = extremes.least.shape[-1] - len(self.quantities)
        return {one: sides[one.statistic][..., first + i] for i, one in enumerate(self.quantities)}


def quantity_signals(quantities: Sequence[Quantity], start: Array) -> QuantitySignals:
    """The signals of those of the quantities that are maxima and minima, of runs from the free nodes `start`."""
    return QuantitySignals(start, tuple(one for one in quantities if one.statistic in OVER_STEPS))
