"""The free swing of one link in a trace of its angle: period, unit of the angle, held, driven and resting stretches.

In a free swing about the zero z, with k = g/L and any damping,

    a = -k sin(phi - z) - c w + noise,

whose terms follow from local polynomials. Windows of one period give k, z and c by least squares. A hand or a drive
gives another k, or a residual above the noise; its energy `w^2/2 + k (1 - cos(phi - z))` rises. The longest stretch of
windows that agree is the free swing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError

#: Samples per period of the grid, half width of the local polynomials in samples, and their degree.
PER_PERIOD = 40
HALF = 7
DEGREE = 4
#: Relative differences of k of one window from that of the swing, and of a residual, that noise need not explain.
SAME = 0.1
RESIDUAL = 0.12
#: Rise of the energy over a period that noise need not explain.
RISES = 0.05
#: Fewest periods of a free swing, and the fraction of the moving file that it must cover.
FEWEST = 3.0
PART = 0.34
#: Loss of energy, over the whole swing, below which it does not decay.
DECAYS = 0.02
#: Periods next to a stretch that is left out, which are left out too.
MARGIN = 0.4
#: Difference of the log likelihoods of two units of the angle that decides between them.
DECIDES = 4.0
#: Periods of the stretches that are compared, and their minimum amplitude as a fraction of the maximum.
BLOCK = 3
LOUD = 0.05
#: Sum of squares of a stretch, in the median one, above which it is not free.
RELEASED = 4.0


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


#: Samples per row from which the spectrum is found, and the most of them.
SAMPLES_PER_ROW = 4
MOST_SAMPLES = 2**16
#: Power of a peak in that of the median noise at its frequency. The highest of 10^5 bins of noise is at 17.
ABOVE_NOISE = 30.0


def main_period(t: np.ndarray, values: np.ndarray) -> float:
    """Period of a motion (k, n) in the unit of `t` (k,): of the largest peak in the spectrum of its rates.

    White noise of the angles has rates whose power grows as the square of the frequency. It is found from the fastest
    quarter to half of what the rows resolve, and subtracted.
    """
    count = min(MOST_SAMPLES, SAMPLES_PER_ROW * len(t))
    grid = np.linspace(t[0], t[-1], count)
    spectrum = np.zeros(count // 2)
    for column in values.T:
        known = np.isfinite(column)
        if known.sum() < 10:
            continue
        rate = np.diff(np.interp(grid, t[known], column[known]))
        spectrum += np.abs(np.fft.rfft((rate - rate.mean()) * np.hanning(len(rate))))[: count // 2] ** 2
    number = np.arange(len(spectrum))
    fastest = max(min(len(t) // 2, len(spectrum)), 8)
    fast = slice(fastest // 2, fastest)
    noise = float(np.median(spectrum[fast] / number[fast] ** 2))
    spectrum = np.maximum(spectrum - ABOVE_NOISE * noise * number**2, 0.0)
    spectrum[:2] = 0.0
    peak = int(np.argmax(spectrum))
    near = spectrum[max(peak - 1, 1) : peak + 2]
    at = peak
    if len(near) == 3 and near.sum() > 0:
        at = peak + (near[2] - near[0]) / (2 * near.sum())
    return float((t[-1] - t[0]) / max(at, 1.0))


def derivatives(t: np.ndarray, phi: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Grid of times (N,), angle, rate and acceleration (N, 3) on it, and the gain of noise in the acceleration [1/s^2].

    Args:
        t, phi: (k,), rows with more than `PER_PERIOD` samples per period are averaged first.
    """
    step = period / PER_PERIOD
    known = np.isfinite(phi)
    t = t[known]
    phi = phi[known]
    grid = np.arange(t[0], t[-1] + 0.5 * step, step)
    index = np.clip(np.round((t - t[0]) / step).astype(int), 0, len(grid) - 1)
    number = np.bincount(index, minlength=len(grid))
    full = number > 0
    times = np.bincount(index, t, len(grid))[full] / number[full]
    angles = np.bincount(index, phi, len(grid))[full] / number[full]
    x = np.interp(grid, times, angles)
    width = 2 * HALF + 1
    if len(x) < 4 * width:
        return grid, np.zeros((0, 3)), 0.0
    powers = np.vander(np.arange(-HALF, HALF + 1) * step, DEGREE + 1, increasing=True)
    weights = np.linalg.pinv(powers)[:3] * [[1.0], [1.0], [2.0]]
    around = np.lib.stride_tricks.sliding_window_view(x, width)
    gain = np.linalg.norm(weights[2]) / np.sqrt(max(1.0, np.median(number[full])))
    return grid[HALF:-HALF], around @ weights.T, float(gain)


def gravity_of_last_link(
    t: np.ndarray, joint: np.ndarray, phi: np.ndarray, period: float
) -> tuple[float, float] | None:
    """Gravity and effective length of the last link of a chain in the unit of its joint; None if it shows neither.

    Across the last link, whose joint moves as J and whose inertia is m l L, `J'' . n + L phi'' = -g sin(phi) - c v_n`.
    No mass enters.

    Args:
        t: (k,) [s].
        joint: (k,), its real part points down.
        phi: (k,) angle from straight down.
    """
    known = np.isfinite(joint) & np.isfinite(phi)
    _, x, _ = derivatives(t[known], joint.real[known], period)
    _, y, _ = derivatives(t[known], joint.imag[known], period)
    _, angle, _ = derivatives(t[known], phi[known], period)
    if len(angle) < PER_PERIOD:
        return None
    phi, w, a = angle.T
    _, speed, acceleration = np.real((x + 1j * y).T * (1j * np.exp(1j * phi)).conj())
    basis = np.stack([np.sin(phi), np.cos(phi), a, speed, w], axis=1)
    found = -np.linalg.lstsq(basis, acceleration, rcond=None)[0]
    if found[2] > 0 and found[0] > 0:
        return float(np.hypot(found[0], found[1])), float(found[2])
    return None


def regression(motion: np.ndarray, quadratic: bool = False) -> tuple[np.ndarray, float]:
    """Coefficients of a = -p sin + q cos - c w (- d |w| w), and the sum of squares."""
    phi, w, a = motion.T
    columns = [-np.sin(phi), np.cos(phi), -w]
    if quadratic:
        columns.append(-np.abs(w) * w)
    basis = np.stack(columns, axis=1)
    found = np.linalg.lstsq(basis, a, rcond=None)[0]
    return found, float(np.sum((basis @ found - a) ** 2))


def squares_by_unit(motion: np.ndarray) -> list[float]:
    """Sums of squares of a motion (k, 3) read in radians and in degrees, in the unit of its angle."""
    return [regression(motion * unit, True)[1] / unit**2 for unit in (1.0, np.pi / 180)]


def half_range(values: np.ndarray) -> np.ndarray:
    """Half the range (n,) of values (k, n) without 0.5 % of them at both ends."""
    return 0.5 * np.subtract(*np.nanquantile(values, [0.995, 0.005], axis=0))


def unit_of_angle(t: np.ndarray, raw: np.ndarray, period: float) -> tuple[str | None, float]:
    """`rad` or `deg`, by the period's change with the amplitude, and the gain in log likelihood; None if undecided.

    Args:
        raw: (k,) in the unknown unit, without wraps.
    """
    reach = half_range(raw)
    if reach < 0.3:
        return "rad", np.inf  # as degrees it would hardly move
    _, motion, _ = derivatives(t, raw, period)
    length = min(BLOCK * PER_PERIOD, len(motion))
    if not length:
        return None, 0.0
    blocks = motion[: len(motion) // length * length].reshape(-1, length, 3)
    size = blocks[..., 0].std(axis=1)
    loud = blocks[size > LOUD * size.max()]
    squares = np.array([squares_by_unit(block) for block in loud])
    smaller = squares.min(axis=1)
    calm = smaller < RELEASED * np.median(smaller)  # without a hand that releases it
    # one k for all amplitudes: in the wrong unit it changes with them
    free = loud[calm].reshape(-1, 3)
    in_radians, in_degrees = np.maximum(squares_by_unit(free), 1e-300)
    # difference of the log likelihoods; accelerations a few samples apart are independent
    gain = 0.5 * len(free) / HALF * float(np.log(in_degrees / in_radians))
    if gain >= DECIDES:
        return "rad", gain
    if gain <= -DECIDES:
        return "deg", -gain
    # a swing of a few degrees is rarer than one of as many radians
    if reach > 2 * np.pi:
        return "deg", 0.0
    if gain > -1.0:
        return "rad", 0.0
    return None, 0.0


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


def fit_windows(times: np.ndarray, motion: np.ndarray) -> SwingWindows:
    """The windows of a motion (k, 3) at times (k,) [s]."""
    first = np.arange(0, len(motion) - PER_PERIOD, PER_PERIOD // 4)
    rows = []
    for low in first:
        part = motion[low : low + PER_PERIOD]
        (p, q, c), left = regression(part)
        size = np.sqrt(np.mean(part[:, 2] ** 2))
        rows.append((np.hypot(p, q), np.arctan2(q, p), c, np.sqrt(left / PER_PERIOD), size))
    last = np.minimum(first + PER_PERIOD, len(times) - 1)
    return SwingWindows(first, times[first], times[last], *np.transpose(rows))


def find_swing(file: str, t: np.ndarray, phi: np.ndarray, period: float, sigma: float) -> Swing:
    """The free swing of one link.

    Args:
        t, phi: (k,) [s], [rad].
        period: of small swings, roughly [s].
        sigma: noise of a row [rad].

    Raises:
        SceneError: driven throughout, too short, or no decay.
    """
    times, motion, gain = derivatives(t, phi, period)
    if len(motion) < (FEWEST + 1) * PER_PERIOD:
        raise SceneError(f"{file}: has fewer than {FEWEST:g} swings of {period:.3g} s. Give a longer file")
    noise = gain * sigma
    windows = fit_windows(times, motion)
    free, level, zero = free_windows(file, motion, windows, noise)
    first, last = longest_run(free)
    inside = slice(first, last + 1)
    begin = windows.begin[first]
    end = windows.end[last]
    check_span(file, windows, begin, end, period, noise)
    check_decay(file, level[inside], end - begin)
    notes = left_out(times, windows, first, end, noise)
    # the window next to a driven stretch may contain a part of it
    if first > 0:
        begin += MARGIN * period
    if last + 1 < len(windows.first):
        end -= MARGIN * period
    rate = np.sqrt(np.mean(motion[windows.first[first] : windows.first[last] + PER_PERIOD, 1] ** 2))
    weights = windows.size[inside] ** 2
    stiffness = float(np.average(windows.stiffness[inside], weights=weights))
    damping = float(np.average(windows.damping[inside], weights=weights))
    return Swing(float(begin), float(end), stiffness, zero, max(damping, 1e-5), float(rate), notes)


def free_windows(
    file: str, motion: np.ndarray, windows: SwingWindows, noise: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Windows (w,) bool that swing freely with the same k, the mean energy (w,) [1/s^2] in each, and the zero [rad].

    Raises:
        SceneError: no window swings freely.
    """
    size = windows.size
    smooth = windows.residual < np.maximum(RESIDUAL * size, 3.0 * noise)
    loud = smooth & (size > 5.0 * noise)
    nothing = SceneError(
        f"{file}: no stretch swings freely: it is driven throughout, or its noise hides the swing. Give a file "
        "with a free swing"
    )
    if loud.sum() < 4:
        raise nothing
    stiffness = np.median(windows.stiffness[loud])
    zero = float(np.angle(np.mean(np.exp(1j * windows.zero[loud]))))
    energy = 0.5 * motion[:, 1] ** 2 + stiffness * (1.0 - np.cos(motion[:, 0] - zero))
    level = np.array([energy[low : low + PER_PERIOD].mean() for low in windows.first])
    error = 3.0 * noise / np.maximum(size, 1e-300)
    free = smooth & (np.abs(windows.stiffness / stiffness - 1.0) < SAME + error) & (size > noise)
    # the energy rises over a period, to the window before its end
    free[1 : len(level) - 3] &= level[4:] <= (1 + RISES) * level[:-4] + 2.0 * noise**2 / stiffness
    if not free.any():
        raise nothing
    return free, level, zero


def check_span(file: str, windows: SwingWindows, begin: float, end: float, period: float, noise: float) -> None:
    """Reject a free swing from `begin` to `end` [s] that is short, or a small part of the motion."""
    moving = windows.size > 2.0 * noise
    moving_span = windows.end[moving].max() - windows.begin[moving].min()
    if end - begin < max(FEWEST * period, PART * moving_span):
        raise SceneError(
            f"{file}: only {end - begin:.3g} of {moving_span:.3g} s swing freely ({begin:.4g} to {end:.4g} s): it is "
            "driven throughout, or pushed again. Give a file with one free swing, or cut it out: --from, --until"
        )


def check_decay(file: str, level: np.ndarray, duration: float) -> None:
    """Reject a swing of this duration [s] whose energy in its windows (w,) does not fall."""
    middle = len(level) // 2
    lowest = level[-4:].mean()
    # a drive reaches a steady swing after a transient that falls
    falls_late = lowest < (1 - 0.5 * DECAYS) * level[middle : middle + 4].mean()
    if not (falls_late and lowest < (1 - DECAYS) * level[:4].mean()):
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


def left_out(times: np.ndarray, windows: SwingWindows, first: int, end: float, noise: float) -> tuple[str, ...]:
    """What lies before and after the free swing from window `first` to `end` [s], in words."""
    found = []
    size = windows.size
    if first > 0:
        held = np.median(size[:first]) < max(3.0 * noise, 0.1 * size[first])
        what = "held" if held else "driven or pushed"
        found.append(f"{what} until {windows.begin[first]:.3g} s: left out")
    if times[-1] - end > 4.0 * (windows.begin[1] - windows.begin[0]):
        later = windows.first + PER_PERIOD / 2 > np.searchsorted(times, end)
        still = not later.any() or np.median(size[later]) < 3.0 * noise
        what = "at rest" if still else "not a free swing"
        found.append(f"{what} from {end:.4g} s on: left out")
    return tuple(found)
