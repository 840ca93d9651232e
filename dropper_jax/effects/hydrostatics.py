"""Buoyancy energy of cylinders and spheres cut by a level surface, exact at every tilt and depth.

The energy of displaced water raised to the surface is `U/(rho g) = int max(level - z, 0) dV`. The buoyancy is then
`-dU/dz`, its moment includes that of the waterplane, and `dU/dlevel/(rho g)` is the submerged volume. A cylinder has
radius a, and its axis rises by the fraction c of its length. A section whose axis is t below the surface has (half
height b = a sqrt(1 - c^2), T = t/b)

    u(t, b) = a^2 (b k(T) | pi t | 0),    k = T asin T + (1 - T^2)^(1/2) + pi T/2 - (1 - T^2)^(3/2)/3

where it is cut (|t| < b), submerged, or above the surface. U is the integral along the axis, from the antiderivative of
u:

    w(t, b) = a^2 (b^2 h(T) | pi (t^2/2 + b^2/8) | 0),    h' = k
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(6)
#: Gauss-Legendre points and weights on 0 to 1.
GAUSS_POINTS = (_POINTS + 1.0) / 2.0
GAUSS_WEIGHTS = _WEIGHTS / 2.0
#: A function of the depth and the half height of sections.
SectionValue = Callable[[Array, Array], Array]


def _cut(t: Array, b: Array) -> tuple[Array, Array, Array]:
    """T of sections that are cut by the surface, its arc sine and (1 - T^2)^(1/2); T = 0 of all others, since the
    last two have no derivatives at T = 1."""
    ratio = jnp.where(jnp.abs(t) < b, t / b, 0.0)
    return ratio, jnp.arcsin(ratio), jnp.sqrt(1.0 - ratio * ratio)


def _by_depth(t: Array, b: Array, cut: Array, under: Array) -> Array:
    """A value of sections that are cut by the surface, that of submerged ones, and zero above the surface."""
    return jnp.where(t >= b, under, jnp.where(t <= -b, 0.0, cut))


def _k(t: Array, b: Array) -> Array:
    """k of sections that are cut."""
    x, arc, root = _cut(t, b)
    return x * arc + root + 0.5 * jnp.pi * x - root**3 / 3.0


def _h(t: Array, b: Array) -> Array:
    """h of sections that are cut, the integral of k from T = -1."""
    x, arc, root = _cut(t, b)
    first = 0.5 * x * x * arc - 0.25 * arc + 0.25 * x * root
    second = 0.5 * (x * root + arc)
    third = x * root**3 / 12.0 + (x * root + arc) / 8.0
    return first + second + 0.25 * jnp.pi * x * x - third + jnp.pi / 16.0


def _chord(t: Array, b: Array) -> Array:
    """d^2u/dt^2: the length of the chord at the surface over a half height."""
    return _by_depth(t, b, 2.0 * _cut(t, b)[2] / b, jnp.zeros_like(t))


@jax.custom_jvp
def _width(t: Array, b: Array) -> Array:
    """du/dt: the submerged part of the section's area."""
    x, arc, root = _cut(t, b)
    return _by_depth(t, b, x * root + arc + 0.5 * jnp.pi, jnp.full_like(t, jnp.pi))


_width.defjvps(
    lambda dt, _, t, b: _chord(t, b) * dt,
    lambda db, _, t, b: -_chord(t, b) * _cut(t, b)[0] * db,
)


@jax.custom_jvp
def _tilt(t: Array, b: Array) -> Array:
    """du/db."""
    return _by_depth(t, b, _k(t, b) - _cut(t, b)[0] * _width(t, b), jnp.zeros_like(t))


_tilt.defjvps(
    lambda dt, _, t, b: -_chord(t, b) * _cut(t, b)[0] * dt,
    lambda db, _, t, b: _chord(t, b) * _cut(t, b)[0] ** 2 * db,
)


@jax.custom_jvp
def section(t: Array, b: Array) -> Array:
    """u/a^2 of sections whose axis is t below the surface and whose half height is b."""
    return _by_depth(t, b, b * _k(t, b), jnp.pi * t)


section.defjvps(lambda dt, _, t, b: _width(t, b) * dt, lambda db, _, t, b: _tilt(t, b) * db)


@jax.custom_jvp
def _along(t: Array, b: Array) -> Array:
    """w/a^2."""
    return _by_depth(t, b, b * b * _h(t, b), jnp.pi * (0.5 * t * t + 0.125 * b * b))


_along.defjvps(lambda dt, _, t, b: section(t, b) * dt, lambda db, _, t, b: _along_tilt(t, b) * db)


@jax.custom_jvp
def _along_tilt(t: Array, b: Array) -> Array:
    """dw/db/a^2."""
    return _by_depth(t, b, 2.0 * b * _h(t, b) - t * _k(t, b), 0.25 * jnp.pi * b)


def _along_bend(t: Array, b: Array) -> Array:
    """d^2w/db^2/a^2."""
    x = _cut(t, b)[0]
    cut = 2.0 * _h(t, b) - 2.0 * x * _k(t, b) + x * x * _width(t, b)
    return _by_depth(t, b, cut, jnp.full_like(t, 0.25 * jnp.pi))


_along_tilt.defjvps(lambda dt, _, t, b: _tilt(t, b) * dt, lambda db, _, t, b: _along_bend(t, b) * db)


#: Minimum half height of a section divided by its radius: an upright cylinder has level sections.
MIN_HALF_HEIGHT = 1e-6
#: A cylinder whose ends differ in depth by less than this part of the sections' half height is integrated numerically.
NEARLY_LEVEL = 0.25


class Cylinders(NamedTuple):
    """Cylinders (n,) relative to the surface.

    Attributes:
        first, last: depths of the ends of their axes [m].
        half: half heights of their sections [m].
        across: level part of the unit vectors along the axes (n, 2).
        radius: a [m]; size: a^2 L [m^3].
        change: last minus first, 1 if `flat`.
        flat: whether sections are integrated numerically.
    """

    first: Array
    last: Array
    half: Array
    across: Array
    radius: Array
    size: Array
    change: Array
    flat: Array

    @classmethod
    def of(cls, ends: Array, level: Array, radius: Array, length: Array) -> Cylinders:
        """From both ends of their axes (n, 2, 3), the level of the surface over each, radius and length (n,) [m]."""
        across = (ends[:, 1, :2] - ends[:, 0, :2]) / length[:, None]
        half = radius * jnp.sqrt(across[:, 0] ** 2 + across[:, 1] ** 2 + MIN_HALF_HEIGHT**2)
        first = level - ends[:, 0, 2]
        last = level - ends[:, 1, 2]
        flat = jnp.abs(last - first) < NEARLY_LEVEL * half
        change = jnp.where(flat, 1.0, last - first)
        return cls(first, last, half, across, radius, radius**2 * length, change, flat)

    @property
    def shares(self) -> Array:
        """Gauss points from 0 to 1 along the axes, in the precision of the cylinders."""
        return jnp.asarray(GAUSS_POINTS, self.first.dtype)

    def _at_points(self, of: SectionValue) -> Array:
        """A function of depth and half height at the Gauss points (n, points)."""
        depths = self.first[:, None] + (self.last - self.first)[:, None] * self.shares
        return of(depths, jnp.broadcast_to(self.half[:, None], depths.shape))

    def _at_ends(self, of: SectionValue) -> Array:
        """A function of depth and half height at both ends (2, n)."""
        return of(jnp.stack([self.first, self.last]), jnp.stack([self.half, self.half]))

    def _mean_slope(self, of: SectionValue) -> Array:
        """Mean slope of a function between the ends (n,)."""
        first, last = self._at_ends(of)
        return (last - first) / self.change

    def _mean(self, of: SectionValue, antiderivative: SectionValue) -> Array:
        """Mean of a function along the axes (n,)."""
        weights = jnp.asarray(GAUSS_WEIGHTS, self.first.dtype)
        return jnp.where(self.flat, self._at_points(of) @ weights, self._mean_slope(antiderivative))

    def energy(self) -> Array:
        """U/(rho g) (n,) [m^4]."""
        return self.size * self._mean(section, _along)

    def volume(self) -> Array:
        """Submerged volume (n,) [m^3]."""
        return self.size * self._mean(_width, section)

    def push(self) -> Array:
        """Buoyancy divided by rho g on the ends of the axes (n, 2, 3) [m^3]: minus the derivative of U."""
        weights = jnp.asarray(GAUSS_WEIGHTS, self.first.dtype)
        mean = self._mean_slope(_along)
        first, last = self._at_ends(section)
        width = self._at_points(_width)
        by_first = jnp.where(self.flat, width @ (weights * (1 - self.shares)), (mean - first) / self.change)
        by_last = jnp.where(self.flat, width @ (weights * self.shares), (last - mean) / self.change)
        # d half/d across = a^2 across/half and d across/d end = 1/L: times a^2 L that is a^4 across/half
        aside = (self.radius**4 / self.half * self._mean(_tilt, _along_tilt))[:, None] * self.across
        up = self.size[:, None, None] * jnp.stack([by_first, by_last], axis=1)[..., None]
        return jnp.concatenate([jnp.stack([aside, -aside], axis=1), up], axis=-1)


def sphere_energy(centre: Array, level: Array, radius: Array) -> Array:
    """U/(rho g) of spheres (n,) [m^4], with centres (n, 3) [m]."""
    deep = level - centre[:, 2]
    d = jnp.clip(deep, -radius, radius)
    cut = jnp.pi * (0.5 * radius**2 * d**2 - d**4 / 12.0 + 2.0 * radius**3 * d / 3.0 + 0.25 * radius**4)
    return cut + 4.0 / 3.0 * jnp.pi * radius**3 * jnp.maximum(deep - radius, 0.0)


def sphere_volume(centre: Array, level: Array, radius: Array) -> Array:
    """Submerged volume of spheres (n,) [m^3]."""
    d = jnp.clip(level - centre[:, 2], -radius, radius)
    return jnp.pi * (radius**2 * d - d**3 / 3.0 + 2.0 / 3.0 * radius**3)
