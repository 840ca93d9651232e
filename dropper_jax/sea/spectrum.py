"""Wave spectra: JONSWAP, Pierson-Moskowitz and TMA, their moments, and components with random phases from a seed.

Wave numbers: linear dispersion in finite depth, at rest and on a current.

    s^2 = g k tanh(k d),    s = w - k U_e,    U_e = 2k/sinh(2kd) * integral of U(z) cosh(2k(z + d)) over the depth

(Kirby and Chen 1989 for U_e). All functions are elementwise, differentiable and free of overflow at any k d.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.constants import GRAVITY
from dropper_jax.sea.current import Scalar


def fenton(omega: Array, depth: Scalar, gravity: Scalar = GRAVITY) -> Array:
    """Wave number [rad/m] of omega [rad/s] at depth [m], Fenton's explicit approximation, within 0.052 %.

    `k d = (a + b^2 sech^2 b)/(tanh b + b sech^2 b)`, `a = w^2 d/g`, `b = a/sqrt(tanh a)` (Fenton 1988, which the paper
    uses in its section 3.2.3; not the cruder one of Fenton and McKee 1990).
    """
    a = omega**2 * depth / gravity
    b = a / jnp.sqrt(jnp.tanh(a))
    sech2 = 1.0 - jnp.tanh(b) ** 2
    return (a + b**2 * sech2) / (jnp.tanh(b) + b * sech2) / depth


@cached_jit()
def wave_number(omega: Array, depth: Scalar, gravity: Scalar = GRAVITY) -> Array:
    """Wave number [rad/m] that satisfies `w^2 = g k tanh(k d)` to rounding, for omega [rad/s] and depth [m]."""
    a = omega**2 * depth / gravity
    kd = fenton(omega, depth, gravity) * depth
    # Newton steps from Fenton's approximation, whose relative error is below 5.2e-4: two reach rounding, the third is a
    # margin
    for _ in range(3):
        tanh = jnp.tanh(kd)
        kd = kd - (kd * tanh - a) / (tanh + kd * (1.0 - tanh**2))
    return kd / depth


def frequency(k: Array, depth: Scalar, gravity: Scalar = GRAVITY) -> Array:
    """Intrinsic frequency `sqrt(g k tanh(k d))` [rad/s]."""
    return jnp.sqrt(gravity * k * jnp.tanh(k * depth))


def group_velocity(k: Array, depth: Scalar, gravity: Scalar = GRAVITY) -> Array:
    """Group velocity in still water `(s/2k) (1 + 2kd/sinh 2kd)` [m/s]."""
    return 0.5 * frequency(k, depth, gravity) / k * (1.0 + ratio_sinh(2.0 * k * depth))


def ratio_sinh(x: Array) -> Array:
    """x/sinh(x) for x > 0 without overflow."""
    return -2.0 * x * jnp.exp(-x) / jnp.expm1(-2.0 * x)


def effective_current(k: Array, depth: Array, profile: Callable[[Array], Array]) -> Array:
    """U_e [m/s] per wave number k (c,): `profile(z)` gives U (c, points) along each wave at heights z (c, points).

    Exact for uniform and, to first order in the shear, for linear profiles: `U - O tanh(kd)/(2k)` for `U + O z`.
    """
    x, weight = np.polynomial.legendre.leggauss(64)
    height = jnp.minimum(depth, 20.0 / k)[:, None]  # the kernel below is e^-40, which is rounding
    z = height * (0.5 * (x - 1.0))
    k2 = 2.0 * k[:, None]
    kernel = -k2 * (jnp.exp(k2 * z) + jnp.exp(-k2 * (z + 2.0 * depth))) / jnp.expm1(-2.0 * k2 * depth)
    return jnp.sum(profile(z) * kernel * (0.5 * weight) * height, axis=1)


#: Newton steps on a current; monotone towards the root, slow only next to blocking.
CURRENT_STEPS = 60


def on_current(
    omega: Array, depth: Array, gravity: Array, profile: Callable[[Array], Array]
) -> tuple[Array, Array, Array]:
    """Wave number, intrinsic frequency s and U_e of waves of absolute frequency omega (c,) on a current.

    Newton on `f(k) = sqrt(g k tanh kd) + k U_e(k) - w`, which is concave for a uniform current: from the root without
    current it converges to the smaller root, which is that of a wave train coming from still water. If the current
    stops the waves no root exists, and the wave number is NaN.
    """

    def excess(k: Array) -> Array:
        return frequency(k, depth, gravity) + k * effective_current(k, depth, profile) - omega

    def correct(k: Array) -> Array:
        value, slope = jax.jvp(excess, (k,), (jnp.ones_like(k),))
        return k - value / jnp.where(slope > 0, slope, jnp.nan)

    start = jax.lax.stop_gradient(wave_number(omega, depth, gravity))
    k = jax.lax.stop_gradient(jax.lax.fori_loop(0, CURRENT_STEPS, lambda _, k: correct(k), start))
    k = correct(k)  # carries the derivative: a Newton step at the root is the implicit function theorem
    k = jnp.where(jnp.abs(excess(k)) < 1e-6 * omega, k, jnp.nan)
    return k, frequency(k, depth, gravity), effective_current(k, depth, profile)


def action_factor(omega: Array, k: Array, current: Array, depth: Array, gravity: Array) -> Array:
    """Amplitude on the current over that in still water: `E (c_g + U_e)/s` is conserved along the wave path.

    In deep water `E/E0 = 4/(s (1 + s)^2)`, `s = sqrt(1 + 4 U w/g)` (Longuet-Higgins and Stewart 1961).
    """
    before = group_velocity(wave_number(omega, depth, gravity), depth, gravity) / omega
    after = (group_velocity(k, depth, gravity) + current) / frequency(k, depth, gravity)
    return jnp.sqrt(before / after)


#: Spectra by name.
SHAPES = ("jonswap", "pierson_moskowitz", "tma")


class Components(NamedTuple):
    """Wave components: amplitude [m], angular frequency [rad/s], phase [rad], direction of travel [rad], each (c,).

    Long-crested components may have one direction, a number.
    """

    amplitude: Array
    omega: Array
    phase: Array
    direction: Array


def shape(x: np.ndarray, gamma: float = 3.3) -> np.ndarray:
    """JONSWAP shape at x = f/fp, scaled to 1 before the peak factor; gamma = 1 is Pierson-Moskowitz.

    `x^-5 exp(-5/4 x^-4) gamma^exp(-(x - 1)^2/(2 s^2))`, s = 0.07 up to the peak, 0.09 beyond (Hasselmann 1973).
    """
    width = np.where(x <= 1.0, 0.07, 0.09)
    return x**-5.0 * np.exp(-1.25 * x**-4.0) * gamma ** np.exp(-((x - 1.0) ** 2) / (2 * width**2))


def depth_factor(omega: Array, depth: Array, gravity: Scalar) -> Array:
    """Kitaigorodskii's factor of a TMA spectrum: `tanh^2(kd)/(1 + 2kd/sinh(2kd))` (Bouws 1985)."""
    kd = wave_number(omega, depth, gravity) * depth
    return jnp.tanh(kd) ** 2 / (1.0 + ratio_sinh(2.0 * kd))


def bins(gamma: float, count: int, kind: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies over the peak frequency and energy fractions (sum 1) of `count` components.

    equal_energy: each component has the same energy and is at the middle of its bin: no common period.
    equal_frequency: equal bins from 0.5 to 4 peak frequencies, each component at random in its bin: no common period.
    even: the same bins with components in their middles, which repeat after one over the bin width.
    """
    x = np.geomspace(0.3, 30.0, 20001)  # 1e-6 of the energy is outside (1.5e-6 without a peak factor)
    energy = shape(x, gamma) * np.gradient(x)
    below = np.cumsum(energy) / np.sum(energy)
    if kind == "equal_energy":
        return np.interp((np.arange(count) + 0.5) / count, below, x), np.full(count, 1.0 / count)
    edges = np.linspace(0.5, 4.0, count + 1)
    share = np.diff(np.interp(edges, x, below))
    inside = 0.5 if kind == "even" else rng.uniform(size=count)
    return edges[:-1] + inside * np.diff(edges), share / np.sum(share)


def spread(exponent: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """`count` directions [rad] about 0 with density `cos^2s(d/2)`: one from each of `count` equal fractions,
    shuffled."""
    angle = np.linspace(-np.pi, np.pi, 4001)
    below = np.cumsum(np.cos(angle / 2) ** (2 * exponent))
    levels = (np.arange(count) + rng.uniform(size=count)) / count
    return rng.permutation(np.interp(levels, below / below[-1], angle))


def components(
    hs: Scalar,
    tp: Scalar,
    direction: Scalar | np.ndarray = 0.0,
    *,
    depth: Scalar,
    gravity: Scalar = GRAVITY,
    spectrum: str = "jonswap",
    gamma: float = 3.3,
    count: int = 200,
    frequencies: str = "equal_energy",
    spreading: float | None = None,
    directions: int = 1,
    seed: int = 0,
) -> Components:
    """A sea of `count` frequencies with random phases; differentiable in hs [m], tp [s], direction [rad] and depth [m].

    Args:
        spectrum: one of `SHAPES`; a TMA sea is the JONSWAP shape times `depth_factor`. All are scaled to `hs`.
        gamma: peak factor (taken as 1 for Pierson-Moskowitz).
        frequencies: see `bins`.
        spreading: s of `cos^2s(d/2)`; None is long-crested.
        directions: directions per frequency. With one, Hs is the same everywhere; with several, components of one
            frequency interfere and Hs depends on the position.
        seed: of the phases and all other random numbers.
    """
    rng = np.random.default_rng(seed)
    if spectrum == "pierson_moskowitz":
        gamma = 1.0
    x, share = bins(gamma, count, frequencies, rng)
    x = np.repeat(x, directions)
    share = np.repeat(share / directions, directions)
    phase = rng.uniform(0.0, 2 * np.pi, x.size)
    course = jnp.asarray(direction)
    if spreading is not None:
        course = course + spread(spreading, x.size, rng)
    omega = 2 * jnp.pi / jnp.asarray(tp) * x
    energy = jnp.asarray(share)
    if spectrum == "tma":
        energy = energy * depth_factor(omega, jnp.asarray(depth), gravity)
        energy = energy / jnp.sum(energy)
    amplitude = jnp.asarray(hs) / 4.0 * jnp.sqrt(2.0 * energy)
    return Components(amplitude, omega, jnp.asarray(phase), course)
