"""Frames of a page: enough to resolve the waves; only a part of a run that is too long for that."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.plots.run import Run
from dropper_jax.plots.series import cycle
from dropper_jax.sea import Sea

#: Frames per wave period of the lines and of the surface, between which the page interpolates linearly.
IN_A_WAVE, OF_SURFACE = 8, 10
#: Maximum and minimum number of frames of the surface.
SURFACE_FRAMES, LEAST_FRAMES = 3750, 60
#: Time over which the mean period of the waves is counted [s], and the number of samples.
COUNTED, SAMPLES = 600.0, 2400


class Shown(NamedTuple):
    """Shown samples of the run, times of the surface [s], and notes about them."""

    frames: np.ndarray
    surface: np.ndarray
    notes: tuple[str, ...]


def choose_samples(run: Run, sea: Sea | None, most: int) -> Shown:
    """At most `most` evenly spaced samples; in waves at least eight per mean period.

    Only a part of a longer run is shown, around its maximum tension.
    """
    t = run.t
    period = 0.0 if sea is None else wave_period(sea, run)
    first, last, notes = 0, len(t) - 1, []
    span = most * period / IN_A_WAVE
    if 0.0 < span < t[-1] - t[0]:
        peak = t[int(np.argmax(np.nan_to_num(run.max_tension).max(axis=1)))]
        begin = min(max(peak - span / 2, t[0]), t[-1] - span)
        first, last = int(np.searchsorted(t, begin)), int(np.searchsorted(t, begin + span, side="right")) - 1
        notes.append(f"shown: {t[first]:.4g} to {t[last]:.4g} s of {t[-1]:.4g} s, around the maximum tension")
    frames = first + even(last - first + 1, most)
    gap = float(np.diff(t[frames]).max(initial=0.0))
    if period > 0.0 and gap > 2.0 * period / IN_A_WAVE:
        notes.append(
            f"saved every {gap:.3g} s in waves of {period:.3g} s: the motion of the lines in between is not known"
        )
    return Shown(frames, _surface_times(t[first], t[last], period), tuple(notes))


def _surface_times(begin: float, end: float, period: float) -> np.ndarray:
    """Times of the surface [s], ten per wave period."""
    if period == 0.0 or end <= begin:
        return np.linspace(begin, end, 2 if end > begin else 1)
    count = int(np.ceil((end - begin) * OF_SURFACE / period)) + 1
    return np.linspace(begin, end, min(max(count, LEAST_FRAMES), SURFACE_FRAMES))


def wave_period(sea: Sea, run: Run) -> float:
    """Mean period between upward crossings of the surface over the middle of the lines [s]; 0 without waves."""
    begin, end = float(run.t[0]), float(run.t[-1])
    times = np.linspace(begin, begin + max(min(end - begin, COUNTED), 60.0), SAMPLES)
    middle = run.positions.mean(axis=(0, 1))
    eta = np.asarray(elevation(sea, np.array([[middle[0], middle[1], 0.0]]), times))[:, 0]
    return cycle(times, eta) if np.ptp(eta) > 1e-6 else 0.0


def elevation(sea: Sea, positions: np.ndarray, times: np.ndarray) -> jax.Array:
    """Elevation (q, m) [m] over positions (m, 3) [m] at times (q,) [s]."""
    find = jax.jit(lambda r, t: jax.lax.map(lambda one: sea.elevation(r, one), t))
    return find(jnp.asarray(positions), jnp.asarray(times))


def even(count: int, most: int) -> np.ndarray:
    """At most `most` of `count` samples, evenly spaced, including the first and the last."""
    return np.unique(np.rint(np.linspace(0, count - 1, min(count, most))).astype(int))
