"""What a run carries from step to step, and the rows that it saves."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.model import Frozen, Model, Parted, State
from dropper_jax.residual import Stepper
from dropper_jax.stepping.extremes import Extremes
from dropper_jax.stepping.step_control import Control, start_control
from dropper_jax.stepping.step_record import StepRecord


class TensionMeans(NamedTuple):
    """Tensions between two saved times: mean and mean square, (k, n) each; steps (k,)."""

    mean: Array
    square: Array
    steps: Array


class Trajectory(NamedTuple):
    """Saved states of a run (k saved times), the start not included.

    Attributes:
        r, v: free nodes (k, nodes, 3) [m], [m/s]; v is the scheme's raw velocity.
        tension: (k, n) [N]; of a run that follows an accuracy the mean since the last saved time.
        work: (k, w) [J], see `work_names`.
        residual: maximum scaled residual since the last saved time (k,).
        retried: steps repeated since then because they did not converge (k,).
        failed: steps since then that ended above tolerance (k,).
        first_bad: number of the first failed step of the run, -1 before any failure (k,).
        parted: broken links, each (k, m), if the scene has failures.
        own: internal states of effects, by effect, each leaf (k, ...).
        extremes: of the watched signals over the steps since the last saved time (k, m), if signals are watched.
        within: tensions since the last saved time, of `advance` with an accuracy; None otherwise, also of `integrate`.
    """

    r: Array
    v: Array
    tension: Array
    work: Array
    residual: Array
    retried: Array
    failed: Array
    first_bad: Array
    parted: Parted | None = None
    own: dict[str, Frozen] | None = None
    extremes: Extremes | None = None
    within: TensionMeans | None = None


class Progress(NamedTuple):
    """State of a run.

    Attributes:
        state: the dynamic state.
        done: steps done; of a run that follows an accuracy the intervals between saved times.
        first_bad: the first of these in which a step failed, -1 without a failure.
        control: what chooses the steps of a run that follows an accuracy; None if all are equal.
        record: lengths of these steps, which the run records or repeats; None if it does neither.
    """

    state: State
    done: Array
    first_bad: Array
    control: Control | None = None
    record: StepRecord | None = None

    @property
    def t(self) -> Array:
        """Time reached [s]."""
        return self.state.t

    @property
    def has_failed(self) -> Array:
        """Whether a step failed."""
        return self.first_bad >= 0


def begin(
    stepper: Stepper, model: Model, s: State, follows: bool = False, record: StepRecord | None = None
) -> Progress:
    """The carry of a run that starts from `s`.

    Args:
        follows: whether its steps follow an accuracy.
        record: where it records their lengths, or the lengths that it repeats.
    """
    s = stepper.integrator.begin(model.with_internal_state(s.own), s)
    if not stepper.track_work:
        s = replace(s, work=jnp.zeros(0, model.dtype))
    control = start_control(stepper, model, s) if follows else None
    return Progress(s, jnp.zeros((), jnp.int32), jnp.asarray(np.int32(-1)), control, record)
