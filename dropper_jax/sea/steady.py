"""Steady waves of finite height on the host: result of all theories, highest wave, and choice of the theory.

All of them move without change of form along +s over a level bed, crest at s = 0 at t = 0:

    eta = sum_j E_j cos j k(s - c t),    u = c_E + sum_j U_j cosh jk(z + d)/cosh jkd cos j k(s - c t)

Fenton, "Nonlinear wave theories", The Sea 9A (1990).
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np

#: Theories by name; `auto` selects the first valid one of linear, stokes5 and stream.
THEORIES = ("linear", "stokes5", "stream", "auto")
#: Meaning of the current as mean velocity of the water (after Fenton): Eulerian, at a fixed position that is always
#: wet, or that of mass transport over the depth (no net flow in a closed flume).
CRITERIA = ("euler", "stokes")
#: Linear theory is valid if the second harmonic of the surface over the first [-] is below this (Le Mehaute).
LINEAR_MAX_HARMONIC = 0.01
#: Stokes V is valid up to this height over that of the highest wave [-] ...
STOKES_MAX_HEIGHT = 0.5
#: ... and below this length over depth [-].
STOKES_MAX_LENGTH = 6.0

#: One number, or several on the host.
Number = TypeVar("Number", float, np.ndarray)


class GivenWave(NamedTuple):
    """What is given of a wave, of which a theory finds the rest.

    Attributes:
        height, depth: [m]; gravity: [m/s^2].
        period, length: [s] or [m], one of the two; the other is None.
        current: mean velocity of the water along the wave [m/s], in the sense of `criterion`, one of `CRITERIA`.
    """

    height: float
    depth: float
    gravity: float
    period: float | None = None
    length: float | None = None
    current: float = 0.0
    criterion: str = "euler"

    def eulerian(self, flow: Number, mean_flux: Number) -> Number | float:
        """c_E, from the mean speed U and from Q/d in the frame of the wave."""
        if self.criterion == "euler":
            return self.current
        return self.current + mean_flux - flow


class SteadyWave(NamedTuple):
    """A solved wave.

    Attributes:
        theory: linear, stokes5 or stream.
        height, depth, length, period: [m], [m], [m], [s] in the frame of the seabed.
        celerity: speed of the crest [m/s] there.
        eulerian, transport: mean velocities c_E and c_S of the water [m/s] (`CRITERIA`).
        flow: mean speed U = c - c_E of the water in the frame of the wave [m/s].
        head: Bernoulli's constant there minus g d [m^2/s^2].
        flux: volume flux Q there [m^2/s].
        surface: E_j, (n,) [m].
        speed: U_j, (n,) [m/s].
        error: residual of the surface conditions, of speed^2 and of flux, over g H and H sqrt(g d).
    """

    theory: str
    height: float
    depth: float
    length: float
    period: float
    celerity: float
    eulerian: float
    transport: float
    flow: float
    head: float
    flux: float
    surface: np.ndarray
    speed: np.ndarray
    error: float = 0.0

    @property
    def wave_number(self) -> float:
        return 2.0 * np.pi / self.length

    @property
    def order(self) -> int:
        return len(self.surface)

    def elevation(self, phase: np.ndarray) -> np.ndarray:
        """Elevation (n,) [m] at phases k(s - c t) (n,) [rad]."""
        return cosine_series(phase, self.surface)

    @property
    def crest(self) -> float:
        """Height of the crest over the mean surface [m]."""
        return float(np.sum(self.surface))

    def velocity(self, phase: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Velocity (n, 2) [m/s], along and up, c_E included, at phases (n,) [rad] and heights z (n,) [m]."""
        across, upright = profiles(self.wave_number, self.depth, z, self.order)
        angle = np.outer(phase, np.arange(1, self.order + 1))
        along = self.eulerian + (across * np.cos(angle)) @ self.speed
        return np.stack([along, (upright * np.sin(angle)) @ self.speed], axis=1)

    @property
    def highest(self) -> float:
        """The highest wave of this length [m]."""
        return highest(self.length, self.depth)


def cosine_series(phase: np.ndarray, harmonics: np.ndarray) -> np.ndarray:
    """`sum_j a_j cos j p` (m,) of harmonics a_j, j = 1..n, at phases p (m,) [rad]."""
    return np.cos(np.outer(phase, np.arange(1, len(harmonics) + 1))) @ harmonics


def profiles(k: float, depth: float, z: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """`cosh jk(z + d)/cosh jkd` and the same of sinh, (n, order) each, free of overflow."""
    jk = k * np.arange(1, order + 1)
    up = np.exp(np.multiply.outer(z, jk))
    down = np.exp(-np.multiply.outer(z + 2.0 * depth, jk))
    scale = 1.0 / (1.0 + np.exp(-2.0 * jk * depth))
    return (up + down) * scale, (up - down) * scale


def highest(length: float, depth: float) -> float:
    """Height [m] at which waves of this length [m] break: Fenton's (1990, eq. 32) fit to Williams (1981).

    `H/d = (0.141063 x + 0.0095721 x^2 + 0.0077829 x^3)/(1 + 0.0788340 x + 0.0317567 x^2 + 0.0093407 x^3)`, x = L/d; in
    deep water 0.141 L, of a solitary wave 0.833 d.
    """
    x = length / depth
    above = np.polyval([0.0077829, 0.0095721, 0.141063, 0.0], x)
    return float(depth * above / np.polyval([0.0093407, 0.0317567, 0.0788340, 1.0], x))


def second_harmonic(height: float, length: float, depth: float) -> float:
    """Second harmonic of the surface over the first, to second order: `k H/8 coth kd (3 coth^2 kd - 1)`."""
    k = 2.0 * np.pi / length
    coth = 1.0 / np.tanh(k * depth)
    return k * height / 8.0 * coth * (3.0 * coth**2 - 1.0)


def fitting_theory(height: float, length: float, depth: float) -> str:
    """The simplest valid theory for a wave of this height and length [m] over a depth [m]."""
    if second_harmonic(height, length, depth) < LINEAR_MAX_HARMONIC:
        return "linear"
    if length < STOKES_MAX_LENGTH * depth and height <= STOKES_MAX_HEIGHT * highest(length, depth):
        return "stokes5"
    return "stream"
