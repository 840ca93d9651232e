"""The equation of one link in a trace of its angle: period, derivatives, gravity of a chain.

In a free swing about the zero z, with k = g/L and any damping,

    a = -k sin(phi - z) - c w + noise,

whose terms follow from local polynomials. It is linear in p = k cos z, q = k sin z and c.
"""

from __future__ import annotations

import numpy as np

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


#: Samples per period of the grid, half width of the local polynomials in samples, and their degree.
GRID_PER_PERIOD = 40
HALF_WIDTH = 7
POLYNOMIAL_DEGREE = 4


def smooth_derivatives(t: np.ndarray, phi: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Grid of times (N,), angle, rate and acceleration (N, 3) on it, and the gain of noise in the acceleration [1/s^2].

    Args:
        t, phi: (k,), rows with more than `GRID_PER_PERIOD` samples per period are averaged first.
    """
    step = period / GRID_PER_PERIOD
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
    width = 2 * HALF_WIDTH + 1
    if len(x) < 4 * width:
        return grid, np.zeros((0, 3)), 0.0
    powers = np.vander(np.arange(-HALF_WIDTH, HALF_WIDTH + 1) * step, POLYNOMIAL_DEGREE + 1, increasing=True)
    weights = np.linalg.pinv(powers)[:3] * [[1.0], [1.0], [2.0]]
    around = np.lib.stride_tricks.sliding_window_view(x, width)
    gain = np.linalg.norm(weights[2]) / np.sqrt(max(1.0, np.median(number[full])))
    return grid[HALF_WIDTH:-HALF_WIDTH], around @ weights.T, float(gain)


def fit_swing_equation(motion: np.ndarray, quadratic: bool = False) -> tuple[np.ndarray, float]:
    """Coefficients of a = -p sin + q cos - c w (- d |w| w), and the sum of squares."""
    phi, w, a = motion.T
    columns = [-np.sin(phi), np.cos(phi), -w]
    if quadratic:
        columns.append(-np.abs(w) * w)
    basis = np.stack(columns, axis=1)
    found = np.linalg.lstsq(basis, a, rcond=None)[0]
    return found, float(np.sum((basis @ found - a) ** 2))


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
    parts = (joint.real, joint.imag, phi)
    x, y, angle = (smooth_derivatives(t[known], part[known], period)[1] for part in parts)
    if len(angle) < GRID_PER_PERIOD:
        return None
    phi, w, a = angle.T
    _, speed, acceleration = np.real((x + 1j * y).T * (1j * np.exp(1j * phi)).conj())
    basis = np.stack([np.sin(phi), np.cos(phi), a, speed, w], axis=1)
    found = -np.linalg.lstsq(basis, acceleration, rcond=None)[0]
    if found[2] > 0 and found[0] > 0:
        return float(np.hypot(found[0], found[1])), float(found[2])
    return None
