"""Traces whose energy rises: rows reversed in time, or two runs in one file.

Damping dissipates energy. Fits of short windows (`short_windows`) do not detect such a trace: without damping a motion
also runs backwards.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model
from fitting.parameters.names import DAMPING
from fitting.traces.conventions import resting_angles
from fitting.traces.noise import smooth_stretch
from fitting.traces.planar import energies, wrap
from fitting.traces.trace import Trace
from fitting.windows.spans import Interval

#: Number of stretches of a run whose median energies are compared.
STRETCHES = 10
#: Minimum fraction of the stretches in which the energy of a reversed run rises; a kick raises it once.
RISING_FRACTION = 0.75
#: Minimum factor by which the energy of a reversed run, or at the start of a second run, grows.
RISE_FACTOR = 1.3
#: Half width of the smoother of the energy, as a fraction of the shortest link's period.
SMOOTHER_PERIODS = 0.06
#: Minimum energy of a second run over the largest of the file, a tenth of its amplitude: at the end of a long decay
#: rounding of an encoder raises smaller ones.
SECOND_RUN_ENERGY = 0.01


def refuse_rising_energy(trace: Trace, model: Model, spans: Sequence[Interval], period: float) -> None:
    """Reject a trace whose energy rises: two runs in one file, or rows reversed in time.

    Args:
        trace: in the model's convention.
        spans: from, to [s] of the fitted samples.
        period: of the shortest link [s].

    Raises:
        SceneError: the time of the second run, or that the rows are reversed.
    """
    if any(e.name not in ("weight", *DAMPING) for e in model.effects):
        return  # water and springs have energies of their own
    whole = (spans[0][0], spans[-1][1])
    if not np.isfinite(trace.between(*whole).theta).any(axis=0).all():
        return  # the energy of a link that is not seen is unknown
    motion = smooth_stretch(trace, whole, SMOOTHER_PERIODS * period)
    if motion is None:
        return
    t, theta, omega = motion
    rest = resting_angles(model)
    every = np.asarray(energies(model, np.vstack([theta, rest]), np.vstack([omega, 0 * rest])))
    energy = every[:-1] - every[-1]
    inside = np.any([(t >= begin) & (t < end) for begin, end in spans], axis=0)
    _refuse_second_run(trace, t[inside], energy[inside], period)
    _refuse_reversed_time(trace, energy[inside])


def _refuse_second_run(trace: Trace, t: np.ndarray, energy: np.ndarray, period: float) -> None:
    """Reject energies (k,) [J] at times (k,) [s] that rise where the angles jump."""
    for at in _breaks(trace):
        before = energy[(t > at - period) & (t < at)]
        after = energy[(t > at) & (t < at + period)]
        # medians: the smoother turns a jump into a transient of a few frames
        if not len(before) or not len(after):
            continue
        if np.median(after) > max(RISE_FACTOR * np.median(before), SECOND_RUN_ENERGY * energy.max()):
            raise SceneError(
                f"{trace.name}: two runs in one file, as it seems: the angles jump at {at:.4g} s, and their energy "
                f"rises from {np.median(before):.3g} to {np.median(after):.3g} J. Use one file per run, or "
                f"--until {at:.4g} for the first one"
            )


def _refuse_reversed_time(trace: Trace, energy: np.ndarray) -> None:
    """Reject energies (k,) [J] that rise in most stretches."""
    parts = np.array([np.median(part) for part in np.array_split(energy, STRETCHES)])
    if np.mean(np.diff(parts) > 0) >= RISING_FRACTION and parts[-2:].mean() > RISE_FACTOR * parts[:2].mean():
        raise SceneError(
            f"{trace.name}: time is reversed, as it seems: the energy of the motion rises from "
            f"{parts[:2].mean():.3g} to {parts[-2:].mean():.3g} J. Reverse the rows"
        )


#: Number of frames on either side of a jump with which it is compared.
NEAR_FRAMES = 5
#: Minimum ratio of a jump to the fastest motion in these frames.
JUMP_RATIO = 4.0
#: Minimum length of a pause before a second run, in sampling intervals.
PAUSE_INTERVALS = 10


def _breaks(trace: Trace) -> np.ndarray:
    """Times [s] at which most links jump, or where frames are missing."""
    move = np.abs(wrap(np.diff(trace.theta, axis=0)))
    around = np.lib.stride_tricks.sliding_window_view(move, 2 * NEAR_FRAMES + 1, axis=0)
    near = np.nanmax(np.delete(around, NEAR_FRAMES, axis=2), axis=2, initial=0.0)
    beyond = move[NEAR_FRAMES:-NEAR_FRAMES] - JUMP_RATIO * near
    beyond[np.isnan(beyond).all(axis=1)] = -1.0  # nothing is known of these frames
    missing = np.diff(trace.t)[NEAR_FRAMES:-NEAR_FRAMES] > PAUSE_INTERVALS * trace.interval
    return trace.t[NEAR_FRAMES + 1 : -NEAR_FRAMES][missing | (np.nanmedian(beyond, axis=1) > 0)]
