"""The free swing of one link in a trace of its angle: period, unit of the angle, held, driven and resting stretches.

In a free swing about the zero z, with k = g/L and any damping,

    a = -k sin(phi - z) - c w + noise,

whose terms follow from local polynomials. Windows of one period give k, z and c by least squares. A hand or a drive
gives another k, or a residual above the noise; its energy `w^2/2 + k (1 - cos(phi - z))` rises. The longest stretch of
windows that agree is the free swing.
"""

from __future__ import annotations

from dataclasses import dataclass

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


def main_period(t: np.ndarray, values: np.ndarray) -> float:
    """Period of a motion (k, n) in the unit of `t` (k,): of the largest peak in the spectrum of its rates."""
    count = int(min(2**16, 4 * len(t)))
    grid = np.linspace(t[0], t[-1], count)
    spectrum = np.zeros(count // 2)
    for column in values.T:
        known = np.isfinite(column)
        if known.sum() < 10:
            continue
        rate = np.diff(np.interp(grid, t[known], column[known]))
        spectrum += np.abs(np.fft.rfft((rate - rate.mean()) * np.hanning(len(rate))))[: count // 2] ** 2
    spectrum[:2] = 0.0
    peak = int(np.argmax(spectrum))
    near = spectrum[max(peak - 1, 1) : peak + 2]
    if len(near) == 3 and near.sum() > 0:
        at = peak + (near[2] - near[0]) / (2 * near.sum())
    else:
        at = peak
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
    mean_t = np.bincount(index, t, len(grid))[full] / number[full]
    mean = np.bincount(index, phi, len(grid))[full] / number[full]
    x = np.interp(grid, mean_t, mean)
    width = 2 * HALF + 1
    if len(x) < 4 * width:
        return grid, np.zeros((0, 3)), 0.0
    powers = np.vander(np.arange(-HALF, HALF + 1) * step, DEGREE + 1, increasing=True)
    weights = np.linalg.pinv(powers)[:3]
    around = np.lib.stride_tricks.sliding_window_view(x, width)
    found = around @ (weights * np.array([1.0, 1.0, 2.0])[:, None]).T
    gain = float(np.linalg.norm(2.0 * weights[2])) / np.sqrt(max(1.0, float(np.median(number[full]))))
    return grid[HALF:-HALF], found, gain


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
    across = 1j * np.exp(1j * angle[:, 0])
    acceleration = np.real((x[:, 2] + 1j * y[:, 2]) * across.conj())
    speed = np.real((x[:, 1] + 1j * y[:, 1]) * across.conj())
    columns = [np.sin(angle[:, 0]), np.cos(angle[:, 0]), angle[:, 2], speed, angle[:, 1]]
    basis = np.stack(columns, axis=1)
    found = -np.linalg.lstsq(basis, acceleration, rcond=None)[0]
    gravity = float(np.hypot(found[0], found[1]))
    length = float(found[2])
    if length > 0 and found[0] > 0:
        return (gravity, length)
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


def unit_of_angle(t: np.ndarray, raw: np.ndarray, period: float) -> tuple[str | None, float]:
    """`rad` or `deg`, by the period's change with the amplitude, and the gain in log likelihood; None if undecided.

    Args:
        raw: (k,) in the unknown unit, without wraps.
    """
    reach = 0.5 * float(np.nanquantile(raw, 0.995) - np.nanquantile(raw, 0.005))
    if reach < 0.3:
        return "rad", np.inf  # as degrees it would hardly move
    _, motion, _ = derivatives(t, raw, period)
    length = min(BLOCK * PER_PERIOD, len(motion))
    blocks = [motion[low : low + length] for low in range(0, len(motion) - length + 1, max(length, 1))]
    size = np.array([float(np.std(block[:, 0])) for block in blocks])
    loud = [block for block, one in zip(blocks, size, strict=True) if one > LOUD * size.max()]
    as_radians, as_degrees = (
        np.array([regression(block * unit, True)[1] / unit**2 for block in loud]) for unit in (1.0, np.pi / 180)
    )
    smaller = np.minimum(as_radians, as_degrees)
    calm = smaller < RELEASED * np.median(smaller)  # without a hand that releases it
    # one k for all amplitudes: in the wrong unit it changes with them
    free = np.concatenate([block for block, one in zip(loud, calm, strict=True) if one])
    in_radians, in_degrees = (regression(free * unit, True)[1] / unit**2 for unit in (1.0, np.pi / 180))
    # difference of the log likelihoods; accelerations a few samples apart are independent
    gain = 0.5 * len(free) / HALF * float(np.log(max(in_degrees, 1e-300) / max(in_radians, 1e-300)))
    if abs(gain) < DECIDES:
        # a swing of a few degrees is rarer than one of as many radians
        if reach > 2 * np.pi:
            likely = "deg"
        elif gain > -1.0:
            likely = "rad"
        else:
            likely = None
        return likely, 0.0
    return ("rad" if gain > 0 else "deg"), abs(gain)


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
    short = f"{file}: has fewer than {FEWEST:g} swings of {period:.3g} s"
    if len(motion) < (FEWEST + 1) * PER_PERIOD:
        raise SceneError(f"{short}. Give a longer file")
    noise = gain * sigma
    starts = np.arange(0, len(motion) - PER_PERIOD, PER_PERIOD // 4)
    fits = np.zeros((len(starts), 5))  # k, z, c, residual, size of the acceleration
    for i, low in enumerate(starts):
        part = motion[low : low + PER_PERIOD]
        (p, q, c), left = regression(part)
        size = float(np.sqrt(np.mean((part[:, 2]) ** 2)))
        residual = float(np.sqrt(left / len(part)))
        fits[i] = np.hypot(p, q), np.arctan2(q, p), c, residual, size
    k, z, c, residual, size = fits.T
    allowed = np.maximum(RESIDUAL * size, 3.0 * noise)
    smooth = residual < allowed
    loud = smooth & (size > 5.0 * noise)
    if loud.sum() < 4:
        raise SceneError(
            f"{file}: no stretch swings freely: it is driven throughout, or its noise hides the swing. Give a file "
            "with a free swing"
        )
    stiffness = float(np.median(k[loud]))
    zero = float(np.angle(np.mean(np.exp(1j * z[loud]))))
    moved = np.cos(motion[:, 0] - zero)
    energy = 0.5 * motion[:, 1] ** 2 + stiffness * (1.0 - moved)
    level = np.array([float(np.mean(energy[low : low + PER_PERIOD])) for low in starts])
    error = 3.0 * noise / np.maximum(size, 1e-300)
    free = smooth & (np.abs(k / stiffness - 1.0) < SAME + error) & (size > 1.0 * noise)
    floor = 2.0 * (noise / np.sqrt(stiffness)) ** 2
    rising = np.concatenate([[False], level[4:] > (1 + RISES) * level[:-4] + floor, [False] * 3])[: len(level)]
    first, last = longest_run(free & ~rising)
    begin = float(times[starts[first]])
    end = float(times[min(starts[last] + PER_PERIOD, len(times) - 1)])
    moving = np.flatnonzero(size > 2.0 * noise)
    moving_span = float(times[min(starts[moving[-1]] + PER_PERIOD, len(times) - 1)] - times[starts[moving[0]]])
    if end - begin < FEWEST * period or end - begin < PART * moving_span:
        raise SceneError(
            f"{file}: only {end - begin:.3g} of {moving_span:.3g} s swing freely ({begin:.4g} to {end:.4g} s): it is "
            "driven throughout, or pushed again. Give a file with one free swing, or cut it out: --from, --until"
        )
    span = level[first : last + 1]
    middle = len(span) // 2
    whole_falls = span[-4:].mean() < (1 - DECAYS) * span[:4].mean()
    # a drive reaches a steady swing after a transient that falls
    half_falls = span[-4:].mean() < (1 - 0.5 * DECAYS) * span[middle : middle + 4].mean()
    if not (whole_falls and half_falls):
        raise SceneError(
            f"{file}: the amplitude does not fall in {end - begin:.3g} s: it is driven throughout, or too short to "
            "show damping. Give a longer free swing"
        )
    notes = left_out(times, starts, first, begin, end, size, noise)
    # the window next to a driven stretch may contain a part of it
    begin += MARGIN * period if first > 0 else 0.0
    end -= MARGIN * period if last + 1 < len(starts) else 0.0
    rate = float(np.sqrt(np.mean(motion[starts[first] : starts[last] + PER_PERIOD, 1] ** 2)))
    inside = slice(first, last + 1)
    weight = size[inside] ** 2
    damping = float(np.sum(c[inside] * weight) / np.sum(weight))
    stiffness = float(np.sum(k[inside] * weight) / np.sum(weight))
    return Swing(begin, end, stiffness, zero, max(damping, 1e-5), rate, notes)


def longest_run(good: np.ndarray) -> tuple[int, int]:
    """First and last number of the longest run of good windows; two bad ones inside do not end it."""
    best = (0, -1)
    start = None
    bad = 0
    for i, one in enumerate(good):
        if one:
            start = i if start is None else start
            bad = 0
            if i - start > best[1] - best[0]:
                best = start, i
        elif start is not None:
            bad += 1
            if bad > 2:
                start = None
    return best


def left_out(
    times: np.ndarray, starts: np.ndarray, first: int, begin: float, end: float, size: np.ndarray, noise: float
) -> tuple[str, ...]:
    """What lies before and after the free swing, in words."""
    found = []
    if first > 0:
        still = np.median(size[:first]) < max(3.0 * noise, 0.1 * size[first])
        what = "held" if still else "driven or pushed"
        found.append(f"{what} until {begin:.3g} s: left out")
    if times[-1] - end > 0.5 * (times[starts[1]] - times[starts[0]]) * 8:
        later = starts + PER_PERIOD / 2 > np.searchsorted(times, end)
        still = not later.any() or np.median(size[later]) < 3.0 * noise
        what = "at rest" if still else "not a free swing"
        found.append(f"{what} from {end:.4g} s on: left out")
    return tuple(found)
