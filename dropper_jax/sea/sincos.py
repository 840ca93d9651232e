"""Sine and cosine together, as elementwise work.

XLA calls the C library for each sine and each cosine of a double, 12 to 15 ns each on the CPU. In a sea of many
components this took most of the time of a step. Written out, the pair takes 2.4 ns.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.numerics import trace_once

#: pi/2 in three parts by the number of bytes of the type. The first two are so short that products with whole numbers
#: below 2^20 (float32: 2^13) are exact (Cody and Waite 1980).
HALF_PI = {
    8: (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21),
    4: (1.5703125, 4.837512969970703125e-4, 7.54978995489188216e-8),
}


#: Taylor coefficients of `(sin r - r)/r^3` and `(cos r - 1 + r^2/2)/r^4` in powers of r^2, |r| <= pi/4: the first
#: omitted term is below 1e-17 of the sum.
SIN = (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800, 1 / 6227020800, -1 / 1307674368000)
COS = (1 / 24, -1 / 720, 1 / 40320, -1 / 3628800, 1 / 479001600, -1 / 87178291200, 1 / 20922789888000)

Pair = tuple[Array, Array]


@jax.custom_jvp
def sincos(x: Array) -> Pair:
    """`(sin x, cos x)` to 2 roundings of 1 for |x| below 1e6 [rad]; float32: 1e4."""
    return _sincos(x)


@trace_once
def _sincos(x: Array) -> Pair:
    turns = jnp.round(x * (2.0 / jnp.pi))
    r = x
    for part in HALF_PI[x.dtype.itemsize]:
        r = r - turns * part
    square = r * r
    sin = jnp.full_like(r, SIN[-1])
    cos = jnp.full_like(r, COS[-1])
    for a, b in zip(SIN[-2::-1], COS[-2::-1], strict=True):
        sin = sin * square + a
        cos = cos * square + b
    sin = r + r * square * sin
    cos = 1.0 - 0.5 * square + square * square * cos
    quarter = turns - 4.0 * jnp.floor(0.25 * turns)
    odd = (quarter == 1.0) | (quarter == 3.0)
    first = jnp.where(odd, cos, sin)
    second = jnp.where(odd, sin, cos)
    return jnp.where(quarter >= 2.0, -first, first), jnp.where((quarter == 1.0) | (quarter == 2.0), -second, second)


@sincos.defjvp
def _sincos_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Pair, Pair]:
    sin, cos = sincos(*primals)
    (dx,) = tangents
    return (sin, cos), (cos * dx, -sin * dx)
