"""Steady waves of finite height on the host: result of all theories, highest wave, and choice of the theory.

All of them move without change of form along +s over a level bed, crest at s = 0 at t = 0:

    eta = sum_j E_j cos j k(s - c t),    u = c_E + sum_j U_j cosh jk(z + d)/cosh jkd cos j k(s - c t)

Fenton, "Nonlinear wave theories", The Sea 9A (1990).
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from dropper_jax.sea.spectrum import wave_number

#: Theories by name; `auto` selects the first valid one of linear, stokes5 and stream.
THEORIES = ("linear", "stokes5", "stream", "auto")
#: Meaning of the current as mean velocity of the water (after Fenton): Eulerian, at a fixed position that is always
#: wet,
#: or that of mass transport over the depth (no net flow in a closed flume).
CRITERIA = ("euler", "stokes")
#: Linear theory is valid if the second harmonic of the surface is below this fraction of the first (Le Mehaute's
#: limit).
LINEAR = 0.01
#: Stokes V is valid up to this fraction of the highest wave and below this length over depth.
STOKES_HEIGHT = 0.5
STOKES_LENGTH = 6.0


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
        return np.cos(np.outer(phase, np.arange(1, self.order + 1))) @ self.surface

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
    above = 0.141063 * x + 0.0095721 * x**2 + 0.0077829 * x**3
    return depth * above / (1.0 + 0.0788340 * x + 0.0317567 * x**2 + 0.0093407 * x**3)


def second_harmonic(height: float, length: float, depth: float) -> float:
    """Second harmonic of the surface over the first, to second order: `k H/8 coth kd (3 coth^2 kd - 1)`."""
    k = 2.0 * np.pi / length
    coth = 1.0 / np.tanh(k * depth)
    return k * height / 8.0 * coth * (3.0 * coth**2 - 1.0)


def fitting_theory(height: float, length: float, depth: float) -> str:
    """The simplest valid theory for a wave of this height and length [m] over a depth [m]."""
    if second_harmonic(height, length, depth) < LINEAR:
        return "linear"
    short = length < STOKES_LENGTH * depth
    if short and height <= STOKES_HEIGHT * highest(length, depth):
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
    e = 0.5 * k * height
    kd = k * depth
    flow, flux, head = _integrals(e, kd, k, depth, gravity)
    if criterion == "euler":
        eulerian = current
    else:
        eulerian = current + flux / depth - flow
    celerity = flow + eulerian
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
        surface=_surface(e, kd) / k,
        speed=_speed(e, kd) * np.sqrt(gravity / k),
    )


def _length(height: float, depth: float, gravity: float, period: float, current: float, criterion: str) -> float:
    """Length [m] of a period: of several, that closest to the length of a linear wave."""

    def excess(k: float) -> float:
        flow, flux, _ = _integrals(0.5 * k * height, k * depth, k, depth, gravity)
        if criterion == "euler":
            celerity = flow + current
        else:
            celerity = current + flux / depth
        return k * celerity - 2.0 * np.pi / period

    omega = 2.0 * np.pi / period
    still = float(wave_number(jnp.asarray(omega), jnp.asarray(depth), gravity))
    k = still * np.geomspace(0.2, 5.0, 400)
    values = np.array([excess(x) for x in k])
    found = np.flatnonzero((values[:-1] <= 0.0) & (values[1:] > 0.0))
    if not found.size:
        raise ValueError("no wave of Stokes' theory has this period")
    from scipy.optimize import brentq  # noqa: PLC0415  (errors in scenes are reported without it)

    first = found[np.argmin(np.abs(np.log(k[found] / still)))]
    return float(2.0 * np.pi / brentq(excess, k[first], k[first + 1], xtol=1e-15, rtol=1e-14))


def _integrals(e: float, kd: float, k: float, depth: float, gravity: float) -> tuple[float, float, float]:
    """Mean speed in the frame of the wave [m/s], volume flux there [m^2/s], Bernoulli's constant minus g d
    [m^2/s^2]."""
    s = _sech(kd)
    th = np.tanh(kd)
    c0 = np.sqrt(th)
    c2 = c0 * (2 + 7 * s**2) / (4 * (1 - s) ** 2)
    c4 = c0 * (4 + 32 * s - 116 * s**2 - 400 * s**3 - 71 * s**4 + 146 * s**5) / (32 * (1 - s) ** 5)
    d2 = -0.5 / c0
    d4 = (2 + 4 * s + s**2 + 2 * s**3) / (8 * c0 * (1 - s) ** 3)
    e2 = th * (2 + 2 * s + 5 * s**2) / (4 * (1 - s) ** 2)
    e4 = th * (8 + 12 * s - 152 * s**2 - 308 * s**3 - 42 * s**4 + 77 * s**5) / (32 * (1 - s) ** 5)
    flow = (c0 + e**2 * c2 + e**4 * c4) * np.sqrt(gravity / k)
    flux = flow * depth + (e**2 * d2 + e**4 * d4) * np.sqrt(gravity / k**3)
    return flow, flux, (0.5 * c0**2 + e**2 * e2 + e**4 * e4) * gravity / k


def _sech(kd: float) -> float:
    return 1.0 / np.cosh(2.0 * min(kd, DEEP_WATER))


def _surface(e: float, kd: float) -> np.ndarray:
    """k E_j, (5,)."""
    s = _sech(kd)
    coth = 1.0 / np.tanh(kd)
    b22 = coth * (1 + 2 * s) / (2 * (1 - s))
    b31 = -3 * (1 + 3 * s + 3 * s**2 + 2 * s**3) / (8 * (1 - s) ** 3)
    b42 = coth * (6 - 26 * s - 182 * s**2 - 204 * s**3 - 25 * s**4 + 26 * s**5) / (6 * (3 + 2 * s) * (1 - s) ** 4)
    b44 = coth * (24 + 92 * s + 122 * s**2 + 66 * s**3 + 67 * s**4 + 34 * s**5) / (24 * (3 + 2 * s) * (1 - s) ** 4)
    common = (3 + 2 * s) * (4 + s) * (1 - s) ** 6
    b53 = np.polyval([82, 467, 194, -2687, -6292, -5897, -2216, 17, 132], s) * 9 / (128 * common)
    b55 = np.polyval([130, 827, 1326, 675, 1188, 2949, 3176, 1579, 300], s) * 5 / (384 * common)
    return np.array(
        [
            e + e**3 * b31 - e**5 * (b53 + b55),
            e**2 * b22 + e**4 * b42,
            -(e**3) * b31 + e**5 * b53,
            e**4 * b44,
            e**5 * b55,
        ]
    )


def _speed(e: float, kd: float) -> np.ndarray:
    """U_j sqrt(k/g), (5,): `C0 j sum_i e^i A_ij cosh jkd`."""
    s = _sech(kd)
    deep = min(kd, DEEP_WATER)
    sh = np.sinh(deep)
    c0 = np.sqrt(np.tanh(kd))
    common = (3 + 2 * s) * (1 - s) ** 6
    a11 = 1 / sh
    a22 = 3 * s**2 / (2 * (1 - s) ** 2)
    a31 = (-4 - 20 * s + 10 * s**2 - 13 * s**3) / (8 * sh * (1 - s) ** 3)
    a33 = (-2 * s**2 + 11 * s**3) / (8 * sh * (1 - s) ** 3)
    a42 = (12 * s - 14 * s**2 - 264 * s**3 - 45 * s**4 - 13 * s**5) / (24 * (1 - s) ** 5)
    a44 = (10 * s**3 - 174 * s**4 + 291 * s**5 + 278 * s**6) / (48 * (3 + 2 * s) * (1 - s) ** 5)
    a51 = np.polyval([-670, -3341, -500, 12554, 20940, 21712, 13232, 32, -1184], s) / (64 * sh * common * (4 + s))
    a53 = np.polyval([58, -117, -1302, -1376, 198, 105, 4, 0], s) / (32 * sh * common)
    a55 = np.polyval([430, 2029, 852, -1552, 272, -6, 0, 0, 0], s) / (64 * sh * common * (4 + s))
    order = np.arange(1, 6)
    sums = np.array(
        [
            e * a11 + e**3 * a31 + e**5 * a51,
            e**2 * a22 + e**4 * a42,
            e**3 * a33 + e**5 * a53,
            e**4 * a44,
            e**5 * a55,
        ]
    )
    return c0 * order * sums * np.cosh(order * deep)
