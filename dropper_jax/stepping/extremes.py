"""Extremes over all steps of signals of a run whose saved states are farther apart than its steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.model import Model, State


class Extremes(NamedTuple):
    """Minimum and maximum of signals (..., m) over the steps since the last saved time, and their times [s].

    Arrays of JAX during a run, of NumPy in a solution.
    """

    least: Any
    largest: Any
    least_at: Any
    largest_at: Any

    def of(self, *index: Any) -> Extremes:
        """Those of some signals: of arrays (k, ...) the parts `[:, *index]`."""
        return Extremes(*(values[:, *index] for values in self))


#: Signals (m,) of a step and their time [s], from the model and the states before and after the step.
Watch = Callable[[Model, State, State], tuple[Array, Array]]


def no_extremes(watch: Watch | None, model: Model, s: State) -> Extremes | None:
    """The extremes of no steps yet; None if nothing is watched."""
    if watch is None:
        return None
    signals = jax.eval_shape(watch, model, s, s)[0]
    far = jnp.full(signals.shape, jnp.inf, signals.dtype)
    now = jnp.full(signals.shape, s.t, signals.dtype)
    return Extremes(far, -far, now, now)


def with_step(
    extremes: Extremes | None, watch: Watch | None, model: Model, before: State, after: State
) -> Extremes | None:
    """The extremes with those of one more step; a NaN is permanent."""
    if extremes is None or watch is None:
        return None
    # apart from the step, whose rounding it would change
    signals, t = watch(model, *jax.lax.optimization_barrier((before, after)))
    return Extremes(
        jnp.minimum(extremes.least, signals),
        jnp.maximum(extremes.largest, signals),
        jnp.where(signals < extremes.least, t, extremes.least_at),
        jnp.where(signals > extremes.largest, t, extremes.largest_at),
    )
