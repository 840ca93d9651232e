"""The samples of a run that the 3D page shows: in waves they resolve the waves, of a too long run only a part."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dropper_jax.plots.run import Run, elevations
from dropper_jax.plots.time_panels import cycle

#: Frames of the lines, and of the surface, per wave period, between which the page interpolates linearly.
IN_A_WAVE = 8
SURFACE_IN_A_WAVE = 10
#: Minimum and maximum number of frames of the surface.
SURFACE_FRAMES = (60, 3750)
#: Time over which the mean period of waves is counted: minimum and maximum [s], and number of samples.
COUNTED_TIME = (60.0, 600.0)
COUNTED_SAMPLES = 2400


class ShownSamples(NamedTuple):
    """Shown samples of the run, times of the surface [s], and notes about them."""

    frames: np.ndarray
    surface: np.ndarray
    notes: tuple[str, ...]


def choose_samples(run: Run, most: int) -> ShownSamples:
    """At most `most` evenly spaced samples; in waves at least eight per mean period.

    Only a part of a longer run is shown, around its maximum tension.
    """
    t = run.t
    period = wave_period(run)
    first = 0
    last = len(t) - 1
    notes = []
    span = most * period / IN_A_WAVE
    if 0.0 < span < t[-1] - t[0]:
        peak = t[int(np.argmax(np.nan_to_num(run.max_tension).max(axis=1)))]
        begin = min(max(peak - span / 2, t[0]), t[-1] - span)
        first = int(np.searchsorted(t, begin))
        last = int(np.searchsorted(t, begin + span, side="right")) - 1
        notes.append(f"shown: {t[first]:.4g} to {t[last]:.4g} s of {t[-1]:.4g} s, around the maximum tension")
    frames = np.unique(np.rint(np.linspace(first, last, min(last - first + 1, most))).astype(int))
    gap = float(np.diff(t[frames]).max(initial=0.0))
    if period > 0.0 and gap > 2.0 * period / IN_A_WAVE:
        notes.append(
            f"saved every {gap:.3g} s in waves of {period:.3g} s: the motion of the lines in between is not known"
        )
    duration = t[last] - t[first]
    count = 1 + int(duration > 0.0)
    if period > 0.0 and duration > 0.0:
        count = int(np.clip(np.ceil(duration * SURFACE_IN_A_WAVE / period) + 1, *SURFACE_FRAMES))
    return ShownSamples(frames, np.linspace(t[first], t[last], count), tuple(notes))


def wave_period(run: Run) -> float:
    """Mean period between upward crossings of the surface over the middle of the lines [s]; 0 without waves."""
    if run.scene.sea is None:
        return 0.0
    begin = run.t[0]
    times = np.linspace(begin, begin + np.clip(run.t[-1] - begin, *COUNTED_TIME), COUNTED_SAMPLES)
    x, y, _ = run.positions.mean(axis=(0, 1))
    eta = elevations(run.scene, np.array([[x, y, 0.0]]), times)[:, 0]
    if np.ptp(eta) > 1e-6:
        return cycle(times, eta)
    return 0.0
