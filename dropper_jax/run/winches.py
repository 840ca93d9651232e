"""Warnings about the winches of a run: drums that swing between their limits, and lengths that reach their limit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

import numpy as np

from dropper_jax.base.records import names_of
from dropper_jax.effects.changing_links import WinchState
from dropper_jax.run.samples import Samples
from dropper_jax.scene.length_in_time import WinchSpec

#: Leaves of a winch's state, in order, of which a run keeps a series each.
LEAVES = tuple(names_of(fields(WinchState)))
#: A drum turns at a limit from this fraction of it on.
AT_LIMIT = 0.99
#: Number of changes from one limit of the rate to the other from which a drum swings ...
SWING_CHANGES = 6
#: ... if it spends at least this fraction of the time between the first and the last of them at a limit.
SWING_SHARE = 0.8


def winch_warnings(solution: Samples) -> Iterator[str]:
    """One line for each winch whose drum swings between the limits of its rate, or ends at one of its length."""
    number = 0
    for line in solution.scene.lines:
        for entry in line.length_in_time:
            if entry.control is None:
                continue
            length = solution.own[f"length_in_time.{number + LEAVES.index('length')}"]
            rate = solution.own[f"length_in_time.{number + LEAVES.index('rate')}"]
            number += len(LEAVES)
            swing_start = _start_of_swings(rate, entry.control)
            if swing_start is not None:
                low, high = entry.control.limits
                yield (
                    f"winch of {line.name}: swings between its limits of {low:g} and {high:g} m/s from "
                    f"{solution.t[swing_start]:.3g} s on, so its gain is unstable. Use a smaller control.gain"
                )
            elif np.any(np.isclose(length[-1], entry.control.lengths, rtol=1e-9)):
                yield (
                    f"winch of {line.name}: ends at its limit of {length[-1]:.4g} m, so the tension is not the target. "
                    "Use wider control.lengths, or another target"
                )


def _start_of_swings(rate: np.ndarray, control: WinchSpec) -> int | None:
    """Saved state from which the rate (k,) [m/s] goes from one limit to the other again and again; None if not."""
    low, high = control.limits
    side = (rate >= AT_LIMIT * high).astype(int) - (rate <= AT_LIMIT * low)
    at = np.flatnonzero(side)
    changes = at[1:][side[at[1:]] != side[at[:-1]]]
    if len(changes) < SWING_CHANGES:
        return None
    between = side[changes[0] : changes[-1] + 1]
    if np.mean(between != 0) < SWING_SHARE:
        return None
    return int(changes[0])
