"""The free swing of one link in a trace of its angle, without held, driven and resting stretches.

Windows of one period give k = g/L, the zero z and the damping c of `pendulum` by least squares. A hand or a drive gives
another k, or a residual above the noise; its energy `w^2/2 + k (1 - cos(phi - z))` rises. The longest stretch of
windows that agree is the free swing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.from_file.pendulum import GRID_PER_PERIOD, fit_swing_equation, smooth_derivatives

#: Relative differences of k of one window from that of the swing, and of a residual, that noise need not explain.
STIFFNESS_TOLERANCE = 0.1
RESIDUAL_TOLERANCE = 0.12
#: Multiple of the noise of an acceleration that a residual, or a line at rest, may show.
NOISE_RATIO = 3.0
#: Multiple of that noise from which a window shows k and z.
LOUD_RATIO = 5.0
#: Rise of the energy over a period that noise need not explain.
ENERGY_TOLERANCE = 0.05
#: Fewest periods of a free swing, and the fraction of the moving file that it must cover.
FEWEST_PERIODS = 3.0
LEAST_FREE_PART = 0.34
#: Loss of energy, over the whole swing, below which it does not decay.
LEAST_DECAY = 0.02
#: Periods next to a stretch that is left out, which are left out too.
MARGIN_PERIODS = 0.4


@dataclass(frozen=True)
class Swing:
    """A free swing.

    Attributes:
        begin, end: its span [s].
        stiffness: g/L [1/s^2].
        zero: angle at rest [rad].
        damping: c [1/s].
        rate: typical rate [rad/s].
        notes: what was left out.
    """

    begin: float
    end: float
    stiffness: float
    zero: float
    damping: float
    rate: float
    notes: tuple[str, ...]


def find_swing(file: str, t: np.ndarray, phi: np.ndarray, period: float, sigma: float) -> Swing:
    """The free swing of one link.

    Args:
        t, phi: (k,) [s], [rad].
        period: of small swings, roughly [s].
        sigma: noise of a row [rad].

    Raises:
        SceneError: driven throughout, too short, or no decay.
    """
    times, motion, gain = smooth_derivatives(t, phi, period)
    if len(motion) < (FEWEST_PERIODS + 1) * GRID_PER_PERIOD:
        raise SceneError(f"{file}: has fewer than {FEWEST_PERIODS:g} swings of {period:.3g} s. Give a longer file")
    noise = gain * sigma
    windows = fit_swing_windows(times, motion)
    free, level, zero = free_windows(file, motion, windows, noise)
    first, last = longest_run(free)
    inside = slice(first, last + 1)
    begin = windows.begin[first]
    end = windows.end[last]
    check_span(file, windows, begin, end, period, noise)
    check_decay(file, level[inside], end - begin)
    notes = describe_left_out(times, windows, first, end, noise)
    # the window next to a driven stretch may contain a part of it
    if first > 0:
        begin += MARGIN_PERIODS * period
    if last + 1 < len(windows.first):
        end -= MARGIN_PERIODS * period
    rate = np.sqrt(np.mean(motion[windows.first[first] : windows.first[last] + GRID_PER_PERIOD, 1] ** 2))
    weights = windows.size[inside] ** 2
    stiffness = float(np.average(windows.stiffness[inside], weights=weights))
    damping = float(np.average(windows.damping[inside], weights=weights))
    return Swing(float(begin), float(end), stiffness, zero, max(damping, 1e-5), float(rate), notes)


class SwingWindows(NamedTuple):
    """Windows of one period (w,), each a quarter of a period after the one before, and the free swing in each alone.

    Attributes:
        first: number of its first sample.
        begin, end: its span [s].
        stiffness: k [1/s^2].
        zero: z [rad].
        damping: c [1/s].
        residual: RMS of what a swing leaves of the acceleration [rad/s^2].
        size: RMS of the acceleration [rad/s^2].
    """

    first: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    stiffness: np.ndarray
    zero: np.ndarray
    damping: np.ndarray
    residual: np.ndarray
    size: np.ndarray


def fit_swing_windows(times: np.ndarray, motion: np.ndarray) -> SwingWindows:
    """The windows of a motion (k, 3) at times (k,) [s]."""
    first = np.arange(0, len(motion) - GRID_PER_PERIOD, GRID_PER_PERIOD // 4)
    rows = []
    for low in first:
        part = motion[low : low + GRID_PER_PERIOD]
        (p, q, c), left = fit_swing_equation(part)
        size = np.sqrt(np.mean(part[:, 2] ** 2))
        rows.append((np.hypot(p, q), np.arctan2(q, p), c, np.sqrt(left / GRID_PER_PERIOD), size))
    last = np.minimum(first + GRID_PER_PERIOD, len(times) - 1)
    return SwingWindows(first, times[first], times[last], *np.transpose(rows))


def free_windows(
    file: str, motion: np.ndarray, windows: SwingWindows, noise: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Windows (w,) bool that swing freely with the same k, the mean energy (w,) [1/s^2] in each, and the zero [rad].

    Raises:
        SceneError: no window swings freely.
    """
    size = windows.size
    smooth = windows.residual < np.maximum(RESIDUAL_TOLERANCE * size, NOISE_RATIO * noise)
    loud = smooth & (size > LOUD_RATIO * noise)
    refusal = SceneError(
        f"{file}: no stretch swings freely: it is driven throughout, or its noise hides the swing. Give a file "
        "with a free swing"
    )
    if loud.sum() < 4:
        raise refusal
    stiffness = np.median(windows.stiffness[loud])
    zero = float(np.angle(np.mean(np.exp(1j * windows.zero[loud]))))
    energy = 0.5 * motion[:, 1] ** 2 + stiffness * (1.0 - np.cos(motion[:, 0] - zero))
    level = np.array([energy[low : low + GRID_PER_PERIOD].mean() for low in windows.first])
    error = NOISE_RATIO * noise / np.maximum(size, 1e-300)
    free = smooth & (np.abs(windows.stiffness / stiffness - 1.0) < STIFFNESS_TOLERANCE + error) & (size > noise)
    # the energy rises over a period, to the window before its end
    free[1 : len(level) - 3] &= level[4:] <= (1 + ENERGY_TOLERANCE) * level[:-4] + 2.0 * noise**2 / stiffness
    if not free.any():
        raise refusal
    return free, level, zero


def check_span(file: str, windows: SwingWindows, begin: float, end: float, period: float, noise: float) -> None:
    """Reject a free swing from `begin` to `end` [s] that is short, or a small part of the motion."""
    moving = windows.size > 2.0 * noise
    moving_span = windows.end[moving].max() - windows.begin[moving].min()
    if end - begin < max(FEWEST_PERIODS * period, LEAST_FREE_PART * moving_span):
        raise SceneError(
            f"{file}: only {end - begin:.3g} of {moving_span:.3g} s swing freely ({begin:.4g} to {end:.4g} s): it is "
            "driven throughout, or pushed again. Give a file with one free swing, or cut it out: --from, --until"
        )


def check_decay(file: str, level: np.ndarray, duration: float) -> None:
    """Reject a swing of this duration [s] whose energy in its windows (w,) does not fall."""
    middle = len(level) // 2
    lowest = level[-4:].mean()
    # a drive reaches a steady swing after a transient that falls
    falls_late = lowest < (1 - 0.5 * LEAST_DECAY) * level[middle : middle + 4].mean()
    if not (falls_late and lowest < (1 - LEAST_DECAY) * level[:4].mean()):
        raise SceneError(
            f"{file}: the amplitude does not fall in {duration:.3g} s: it is driven throughout, or too short to "
            "show damping. Give a longer free swing"
        )


def longest_run(good: np.ndarray) -> tuple[int, int]:
    """First and last number of the longest run of good windows; two bad ones inside do not end it."""
    best = (0, -1)
    start = None
    bad = 0
    for i, one in enumerate(good):
        if one:
            if start is None:
                start = i
            bad = 0
            if i - start > best[1] - best[0]:
                best = start, i
        elif start is not None:
            bad += 1
            if bad > 2:
                start = None
    return best


def describe_left_out(
    times: np.ndarray, windows: SwingWindows, first: int, end: float, noise: float
) -> tuple[str, ...]:
    """What lies before and after the free swing from window `first` to `end` [s], in words."""
    found = []
    size = windows.size
    if first > 0:
        held = np.median(size[:first]) < max(NOISE_RATIO * noise, 0.1 * size[first])
        what = "held" if held else "driven or pushed"
        found.append(f"{what} until {windows.begin[first]:.3g} s: left out")
    if times[-1] - end > 4.0 * (windows.begin[1] - windows.begin[0]):
        later = windows.first + GRID_PER_PERIOD / 2 > np.searchsorted(times, end)
        still = not later.any() or np.median(size[later]) < NOISE_RATIO * noise
        what = "at rest" if still else "not a free swing"
        found.append(f"{what} from {end:.4g} s on: left out")
    return tuple(found)
