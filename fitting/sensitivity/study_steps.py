"""The steps of the own run of a study, which its other runs repeat."""

from __future__ import annotations

import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.stepping.adaptive import find_lengths
from dropper_jax.stepping.integrate import Steps
from dropper_jax.stepping.step_record import MOST_STEPS
from dropper_jax.study.march import spare_rows


@cached_jit(static=("stepper",), kernel=True)
def find_step_lengths(
    stepper: Stepper, model: Model, s: State, interval: Array, rows: Array, accuracy: Array
) -> tuple[Array, Array, Array]:
    """`find_lengths` of any run."""
    return find_lengths(stepper, model, s, interval, rows, accuracy, MOST_STEPS)


def make_steps(model: Model, length: np.ndarray, ends: np.ndarray, failed: bool) -> Steps:
    """Steps of these lengths [s], with intervals that have these ends.

    Their arrays are NumPy's: for those of JAX, every shape has a program that copies it.
    """
    none = np.zeros(len(ends), np.int32)
    residual = np.zeros(len(ends), model.dtype)
    return Steps(length.astype(model.dtype), ends.astype(np.int32), residual, none, np.full(len(ends), failed))


def part_of_steps(steps: Steps, first: int, rows: int) -> Steps:
    """The steps of `rows` intervals from number `first` on."""
    length, ends, *others = map(np.asarray, steps)
    begin = ends[first - 1] if first else 0
    ends = ends[first : first + rows]
    return Steps(length[begin : ends[-1]], ends - begin, *(x[first : first + rows] for x in others))


def padded(steps: Steps) -> Steps:
    """The same with room for more steps and intervals, so that one program serves many durations."""
    return Steps(*(np.pad(np.asarray(x), (0, spare_rows(len(x)) - len(x))) for x in steps))


def saved_times(steps: Steps) -> np.ndarray:
    """Ends of the intervals (k,) [s] from the start of the run."""
    return np.cumsum(np.asarray(steps.length))[np.asarray(steps.ends) - 1]
