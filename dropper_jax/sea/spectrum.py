"""Wave spectra: JONSWAP, Pierson-Moskowitz and TMA, and components with random phases from a seed."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.constants import GRAVITY
from dropper_jax.sea.current import Scalar
from dropper_jax.sea.dispersion import ratio_sinh, wave_number

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
