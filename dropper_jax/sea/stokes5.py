"""Stokes' theory to fifth order: Fenton (1985), in the form of Fenton (1990).

Coefficients are polynomials in s = sech 2kd; amplitudes are powers of the steepness e = k H/2.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from dropper_jax.sea.dispersion import wave_number
from dropper_jax.sea.steady import GivenWave, SteadyWave

#: Above this kd the water is deep to rounding; the coefficients are evaluated there without overflow.
DEEP_WATER = 20.0


def stokes5(given: GivenWave) -> SteadyWave:
    """The wave of a height with a period or a length.

    Raises:
        ValueError: no length for this period.
    """
    depth = given.depth
    length = given.length
    if length is None:
        length = _length(given)
    k = 2.0 * np.pi / length
    flow, flux, head = _integrals(given, k)
    eulerian = given.eulerian(flow, flux / depth)
    celerity = flow + eulerian
    powers = (0.5 * k * given.height) ** np.arange(1, 6)
    return SteadyWave(
        theory="stokes5",
        height=given.height,
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
        speed=_speed(k * depth) @ powers * np.sqrt(given.gravity / k),
    )


def _length(given: GivenWave) -> float:
    """Length [m] of a period: of several, that closest to the length of a linear wave."""
    omega = 2.0 * np.pi / given.period

    def excess(k: float) -> float:
        flow, flux, _ = _integrals(given, k)
        return k * (flow + given.eulerian(flow, flux / given.depth)) - omega

    still = float(wave_number(jnp.asarray(omega), jnp.asarray(given.depth), given.gravity))
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


def _integrals(given: GivenWave, k: float) -> tuple[float, float, float]:
    """Mean speed in the frame of the wave [m/s], volume flux there [m^2/s], Bernoulli's constant minus g d
    [m^2/s^2]."""
    height, depth, gravity = given[:3]
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
