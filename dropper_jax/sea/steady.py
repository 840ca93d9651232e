"""Steady waves of finite height on the host: result of all theories, highest wave, and choice of the theory.

All of them move without change of form along +s over a level bed, crest at s = 0 at t = 0:

    eta = sum_j E_j cos j k(s - c t),    u = c_E + sum_j U_j cosh jk(z + d)/cosh jkd cos j k(s - c t)

Fenton, "Nonlinear wave theories", The Sea 9A (1990).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np

from dropper_jax.sea.spectrum import wave_number

#: Theories by name; `auto` selects the first valid one of linear, stokes5 and stream.
THEORIES = ("linear", "stokes5", "stream", "auto")
#: Meaning of the current as mean velocity of the water (after Fenton): Eulerian, at a fixed position that is always
#: wet, or that of mass transport over the depth (no net flow in a closed flume).
CRITERIA = ("euler", "stokes")
#: Linear theory is valid if the second harmonic of the surface is below this fraction of the first (Le Mehaute).
LINEAR = 0.01
#: Stokes V is valid up to this fraction of the highest wave and below this length over depth.
STOKES_HEIGHT = 0.5
STOKES_LENGTH = 6.0

#: One number, or several on the host.
Number = TypeVar("Number", float, np.ndarray)


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


def eulerian_velocity(criterion: str, current: float, flow: Number, mean_flux: Number) -> Number | float:
    """c_E of a current in the sense of `criterion`, of the mean speed U and of Q/d in the frame of the wave."""
    if criterion == "euler":
        return current
    return current + mean_flux - flow


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
    if second_harmonic(height, length, depth) < LINEAR:
        return "linear"
    if length < STOKES_LENGTH * depth and height <= STOKES_HEIGHT * highest(length, depth):
        return "stokes5"
    return "stream"


#: Above this kd the water is deep to rounding; the coefficients are evaluated there without overflow.
DEEP_WATER = 20.0


def stokes5(
    height: float,
    depth: float,
    gravity: float,
    *,
    period: float | None = None,
    length: float | None = None,
    current: float = 0.0,
    criterion: str = "euler",
) -> SteadyWave:
    """A wave of a height [m] over a depth [m] with a period [s] or a length [m].

    Args:
        current: mean velocity of the water along the wave [m/s], in the sense of `criterion` (`steady.CRITERIA`).

    Raises:
        ValueError: no length for this period.
    """
    if length is None:
        length = _length(height, depth, gravity, period, current, criterion)
    k = 2.0 * np.pi / length
    flow, flux, head = _integrals(height, k, depth, gravity)
    eulerian = eulerian_velocity(criterion, current, flow, flux / depth)
    celerity = flow + eulerian
    powers = (0.5 * k * height) ** np.arange(1, 6)
    return SteadyWave(
        theory="stokes5",
        height=height,
        depth=depth,
        length=length,
        period=length / celerity,
        celerity=celerity,
        eulerian=eulerian,
        transport=celerity - flux / depth,
        flow=flow,
        head=head,
        flux=flux,
        surface=_surface(k * depth) @ powers / k,
        speed=_speed(k * depth) @ powers * np.sqrt(gravity / k),
    )


def _length(height: float, depth: float, gravity: float, period: float, current: float, criterion: str) -> float:
    """Length [m] of a period: of several, that closest to the length of a linear wave."""
    omega = 2.0 * np.pi / period

    def excess(k: float) -> float:
        flow, flux, _ = _integrals(height, k, depth, gravity)
        return k * (flow + eulerian_velocity(criterion, current, flow, flux / depth)) - omega

    still = float(wave_number(jnp.asarray(omega), jnp.asarray(depth), gravity))
    k = still * np.geomspace(0.2, 5.0, 400)
    values = np.array(list(map(excess, k)))
    rising = np.flatnonzero((values[:-1] <= 0.0) & (values[1:] > 0.0))
    if not rising.size:
        raise ValueError("no wave of Stokes' theory has this period")
    from scipy.optimize import brentq  # noqa: PLC0415  (errors in scenes are reported without it)

    first = rising[np.argmin(np.abs(np.log(k[rising] / still)))]
    return float(2.0 * np.pi / brentq(excess, k[first], k[first + 1], xtol=1e-15, rtol=1e-14))


def _sech(kd: float) -> float:
    """s = sech 2kd, in which the coefficients of Stokes' theory are polynomials."""
    return 1.0 / np.cosh(2.0 * min(kd, DEEP_WATER))


def _ratio(s: float, numerator: Sequence[float], divisor: float, power: int) -> float:
    """`p(s)/(divisor (1 - s)^power)`, the coefficient of the highest power of p first."""
    return float(np.polyval(numerator, s)) / (divisor * (1.0 - s) ** power)


def _integrals(height: float, k: float, depth: float, gravity: float) -> tuple[float, float, float]:
    """Mean speed in the frame of the wave [m/s], volume flux there [m^2/s], Bernoulli's constant minus g d
    [m^2/s^2]."""
    s = _sech(k * depth)
    th = np.tanh(k * depth)
    c0 = np.sqrt(th)
    c2 = c0 * _ratio(s, [7, 0, 2], 4, 2)
    c4 = c0 * _ratio(s, [146, -71, -400, -116, 32, 4], 32, 5)
    d2 = -0.5 / c0
    d4 = _ratio(s, [2, 1, 4, 2], 8, 3) / c0
    e2 = th * _ratio(s, [5, 2, 2], 4, 2)
    e4 = th * _ratio(s, [77, -42, -308, -152, 12, 8], 32, 5)
    steepness = (0.5 * k * height) ** np.array([0, 2, 4])
    flow = steepness @ [c0, c2, c4] * np.sqrt(gravity / k)
    flux = flow * depth + steepness @ [0.0, d2, d4] * np.sqrt(gravity / k**3)
    return flow, flux, steepness @ [0.5 * th, e2, e4] * gravity / k


def _surface(kd: float) -> np.ndarray:
    """Coefficients (5, 5) of e, e^2, ..., e^5, e = k H/2, in each k E_j."""
    s = _sech(kd)
    coth = 1.0 / np.tanh(kd)
    third = 3 + 2 * s
    fourth = third * (4 + s)
    b22 = coth * _ratio(s, [2, 1], 2, 1)
    b33 = _ratio(s, [6, 9, 9, 3], 8, 3)
    b42 = coth * _ratio(s, [26, -25, -204, -182, -26, 6], 6 * third, 4)
    b44 = coth * _ratio(s, [34, 67, 66, 122, 92, 24], 24 * third, 4)
    b53 = 9 * _ratio(s, [82, 467, 194, -2687, -6292, -5897, -2216, 17, 132], 128 * fourth, 6)
    b55 = 5 * _ratio(s, [130, 827, 1326, 675, 1188, 2949, 3176, 1579, 300], 384 * fourth, 6)
    return np.array(
        [
            [1.0, 0.0, -b33, 0.0, -b53 - b55],
            [0.0, b22, 0.0, b42, 0.0],
            [0.0, 0.0, b33, 0.0, b53],
            [0.0, 0.0, 0.0, b44, 0.0],
            [0.0, 0.0, 0.0, 0.0, b55],
        ]
    )


def _speed(kd: float) -> np.ndarray:
    """Coefficients (5, 5) of e, e^2, ..., e^5 in each U_j sqrt(k/g): `C0 j A_ij cosh jkd`."""
    s = _sech(kd)
    deep = min(kd, DEEP_WATER)
    sh = np.sinh(deep)
    third = 3 + 2 * s
    fourth = third * (4 + s)
    a22 = _ratio(s, [3, 0, 0], 2, 2)
    a31 = _ratio(s, [-13, 10, -20, -4], 8 * sh, 3)
    a33 = _ratio(s, [11, -2, 0, 0], 8 * sh, 3)
    a42 = _ratio(s, [-13, -45, -264, -14, 12, 0], 24, 5)
    a44 = _ratio(s, [278, 291, -174, 10, 0, 0, 0], 48 * third, 5)
    a51 = _ratio(s, [-670, -3341, -500, 12554, 20940, 21712, 13232, 32, -1184], 64 * sh * fourth, 6)
    a53 = _ratio(s, [58, -117, -1302, -1376, 198, 105, 4, 0], 32 * sh * third, 6)
    a55 = _ratio(s, [430, 2029, 852, -1552, 272, -6, 0, 0, 0], 64 * sh * fourth, 6)
    rows = np.array(
        [
            [1.0 / sh, 0.0, a31, 0.0, a51],
            [0.0, a22, 0.0, a42, 0.0],
            [0.0, 0.0, a33, 0.0, a53],
            [0.0, 0.0, 0.0, a44, 0.0],
            [0.0, 0.0, 0.0, 0.0, a55],
        ]
    )
    order = np.arange(1, 6)
    return np.sqrt(np.tanh(kd)) * (order * np.cosh(order * deep))[:, None] * rows
