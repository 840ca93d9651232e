"""Amplitude spectra of uniformly sampled signals."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.read import read_text

WINDOWS = ("hann", "none")
#: Maximum deviation of a time step from the mean one, relative to it.
STEP_TOLERANCE = 1e-6


def amplitude_spectrum(t: np.ndarray, x: np.ndarray, window: str = "hann") -> tuple[np.ndarray, np.ndarray]:
    """Single-sided amplitude spectrum: a sine of amplitude A whose frequency is on a bin has height A there.

    `A_m = 2 |sum_j w_j (x_j - mean x) exp(-2 pi i j m/k)| / sum_j w_j`, without the 2 at zero frequency and, for even
    k, at the Nyquist frequency. Between two bins a sine loses up to 15 % with the Hann window and 36 % with none.

    Args:
        t: (k,) [s], uniformly spaced, k >= 2.
        x: (k,) or (k, n), any unit; finite.
        window: "hann" (periodic Hann window) or "none".

    Returns:
        frequency (k//2 + 1,) [Hz]; amplitude (k//2 + 1,) or (k//2 + 1, n) [unit of x].

    Raises:
        ValueError: sampling that is not uniform, values that are not finite, shapes that do not match, another window.
    """
    t = np.asarray(t)
    x = np.asarray(x)
    read_text(window, "window", WINDOWS)
    step = _uniform_step(t)
    if x.ndim not in (1, 2) or len(x) != len(t):
        raise ValueError(f"x: shape {x.shape}, must be ({len(t)},) or ({len(t)}, n) like t")
    if not np.isfinite(x).all():
        raise ValueError("x: has values that are not finite")
    count = len(t)
    weight = np.ones(count)
    if window == "hann":
        weight = np.hanning(count + 1)[:-1]
    centred = ((x - x.mean(axis=0)).T * weight).T
    amplitude = 2 * np.abs(np.fft.rfft(centred, axis=0)) / weight.sum()
    amplitude[0] /= 2
    if count % 2 == 0:
        amplitude[-1] /= 2
    return np.fft.rfftfreq(count, step), amplitude


def _uniform_step(t: np.ndarray) -> float:
    """The step [s] of uniform times (k,)."""
    if t.ndim != 1 or len(t) < 2:
        raise ValueError(f"t: shape {t.shape}, must be (k,) with k >= 2")
    if not np.isfinite(t).all():
        raise ValueError("t: has values that are not finite")
    steps = np.diff(t.astype(float))
    mean = steps.mean()
    precision = np.dtype(float)
    if t.dtype.kind == "f":
        precision = t.dtype
    # differences of times carry the rounding of the times themselves
    rounding = 4 * np.finfo(precision).eps * np.abs(t).max()
    if mean <= 0 or np.abs(steps - mean).max() > STEP_TOLERANCE * mean + rounding:
        raise ValueError(f"t: steps from {steps.min():g} to {steps.max():g} s, must be uniform and positive")
    return float(mean)
