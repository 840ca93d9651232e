"""Amplitude spectra of uniformly sampled signals."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dropper_jax.analysis.angles import angle_rates, link_angles
from dropper_jax.base.read import Table, read_text

WINDOWS = ("hann", "none")


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


#: Maximum deviation from uniform sampling, relative to the step.
UNEVEN = 1e-6


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
    rounding = 4 * np.finfo(precision).eps * np.abs(t).max()
    if mean <= 0 or np.abs(steps - mean).max() > UNEVEN * mean + rounding:
        raise ValueError(f"t: steps from {steps.min():g} to {steps.max():g} s, must be uniform and positive")
    return float(mean)


ANGLES = ("polar", "azimuth")


def phase_curve(
    positions: np.ndarray, velocities: np.ndarray, link: int = 0, zero: str = "horizontal", angle: str = "polar"
) -> tuple[np.ndarray, np.ndarray]:
    """Angle and rate of one link along a motion.

    Args:
        positions, velocities: (k, n + 1, 3) [m], [m/s].
        link: which, 0 .. n - 1; negative counts from the last.
        zero: convention of the polar angle, see `link_angles`.
        angle: "polar" or "azimuth".

    Returns:
        angle (k,) [rad] and rate (k,) [rad/s].

    Raises:
        ValueError: no such link, another `zero` or `angle`.
    """
    read_text(angle, "angle", ANGLES)
    positions = np.asarray(positions)
    velocities = np.asarray(velocities)
    links = positions.shape[1] - 1
    if not -links <= link < links:
        raise ValueError(f"link = {link}: must be from {-links} to {links - 1}")
    nodes = [link % links, link % links + 1]
    which = ANGLES.index(angle)
    values = link_angles(positions[:, nodes], zero)[which]
    rates = angle_rates(positions[:, nodes], velocities[:, nodes], zero)[which]
    return values[:, 0], rates[:, 0]


class Energies(Protocol):
    """Attributes of a solution: kinetic, potential (k,) [J]; work (k, w) [J] since the start, named by `work_names`."""

    kinetic: np.ndarray
    potential: np.ndarray
    work: np.ndarray
    work_names: tuple[str, ...]


def balance_drift(solution: Energies) -> np.ndarray:
    """`E(t) - E(0) - sum of the work done since`, (k,) [J]: zero for an exact solution.

    Work includes energy taken out (damping, friction) and put in (applied forces, moving ends).
    """
    with np.errstate(invalid="ignore"):  # a failed run may contain infinities
        total = np.asarray(solution.kinetic) + np.asarray(solution.potential)
        work = _work(solution).sum(axis=1)
        return (total - total[0]) - (work - work[0])


def effect_power(solution: Energies, t: np.ndarray) -> dict[str, np.ndarray]:
    """Mean power of each contribution between saved times, {name: (k - 1,)} [W]: `(W_i+1 - W_i)/(t_i+1 - t_i)`.

    Exact as a mean, because the work is summed step by step along with the motion.
    """
    power = np.diff(_work(solution), axis=0) / np.diff(np.asarray(t))[:, None]
    return dict(zip(solution.work_names, power.T, strict=True))


def energy_table(solution: Energies) -> Table:
    """Energies at both ends of a run, work by contribution, and how well the balance closes.

    Returns:
        `initial` and `final`, each {kinetic, potential, total} [J]; `work` {name: J}, over the whole run; `scale` [J],
        the larger of the greatest kinetic energy and the range of the potential; `drift` {final, largest} [J] and
        `relative_drift`, the largest over the scale (0 where nothing moves).
    """
    kinetic = np.asarray(solution.kinetic)
    potential = np.asarray(solution.potential)
    work = _work(solution)
    drift = balance_drift(solution)
    with np.errstate(invalid="ignore"):
        scale = float(max(kinetic.max(), np.ptp(potential)))
    largest = float(np.abs(drift).max())
    relative = 0.0
    if scale != 0.0:
        relative = largest / scale
    return {
        "initial": _instant(kinetic[0], potential[0]),
        "final": _instant(kinetic[-1], potential[-1]),
        "work": dict(zip(solution.work_names, (work[-1] - work[0]).tolist(), strict=True)),
        "scale": scale,
        "drift": {"final": float(drift[-1]), "largest": largest},
        "relative_drift": relative,
    }


def _work(solution: Energies) -> np.ndarray:
    return np.asarray(solution.work).reshape(len(solution.kinetic), -1)


def _instant(kinetic: float, potential: float) -> dict[str, float]:
    kinetic = float(kinetic)  # Python's numbers give no warning about infinities of a failed run
    potential = float(potential)
    return {"kinetic": kinetic, "potential": potential, "total": kinetic + potential}
