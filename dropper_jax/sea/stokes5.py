"""Stokes waves of fifth order: the coefficients of Fenton (1985), "A fifth-order Stokes theory for steady waves",
Journal of Waterway, Port, Coastal and Ocean Engineering 111(2), table 1, with `S = sech 2kd` and `e = kH/2`.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from dropper_jax.sea.dispersion import wave_number
from dropper_jax.sea.steady import SteadyWave

#: Above this kd the water is deep to rounding; the coefficients are evaluated there without overflow.
DEEP = 20.0


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
    e, kd = 0.5 * k * height, k * depth
    flow, flux, head = _integrals(e, kd, k, depth, gravity)
    eulerian = current if criterion == "euler" else current + flux / depth - flow
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
        celerity = flow + current if criterion == "euler" else current + flux / depth
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
    s, th = _sech(kd), np.tanh(kd)
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
    return 1.0 / np.cosh(2.0 * min(kd, DEEP))


def _surface(e: float, kd: float) -> np.ndarray:
    """k E_j, (5,)."""
    s, coth = _sech(kd), 1.0 / np.tanh(kd)
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
    s, deep = _sech(kd), min(kd, DEEP)
    sh, c0 = np.sinh(deep), np.sqrt(np.tanh(kd))
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
