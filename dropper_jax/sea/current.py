"""Currents, horizontal everywhere: uniform, power law, table over depth, each steady or scaled over time; tides."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.fields import component, option, parameter

#: One number, also of a trace.
Scalar = Array | float
#: Several numbers.
Numbers = Array | np.ndarray


def harmonic(part: Level | Current, t: Array) -> Array | None:
    """`sum_i a_i cos(2 pi t/T_i - p_i)` at time t [s], None without constituents; phases are lags as in tide tables."""
    if part.amplitude is None or part.period is None or part.phase is None:
        return None
    return jnp.sum(part.amplitude * jnp.cos(2.0 * jnp.pi * t / part.period - part.phase))


@component
class Level:
    """Height of the mean surface over z = 0, the reference level of the scene [m], and its rate.

    The water moves as with the depth `d + level` and z measured from there. Wave numbers are those of d, and the
    vertical velocity of the level (some 1e-4 m/s) is left out.
    """

    offset: Scalar = parameter("constant part", unit="m", default=0.0)
    time: Numbers | None = parameter("times of a table", unit="s", shape="table", default=None)
    height: Numbers | None = parameter("heights at those times", unit="m", shape="table", default=None)
    amplitude: Numbers | None = parameter("of constituents", unit="m", shape="table", default=None)
    period: Numbers | None = parameter("their periods", unit="s", shape="table", default=None)
    phase: Numbers | None = parameter("their lags", unit="rad", shape="table", default=None)

    def at(self, t: Array) -> Array:
        """The level [m] at time t [s]; a table is constant outside its times."""
        level = jnp.asarray(self.offset)
        if self.time is not None and self.height is not None:
            level = level + jnp.interp(t, self.time, self.height)
        tide = harmonic(self, t)
        if tide is not None:
            level = level + tide
        return level


KINDS = ("uniform", "power", "table")
#: A power law is linear below this fraction of its reference height, since its slope at the seabed is infinite.
LINEAR_BELOW = 0.01


@component
class Current:
    """Velocity `U(z) s(t)` along a fixed direction, or turning with depth: by `veer` or in a table.

    power: `U = speed ((d + z)/(d + reference))^exponent` (paper (4)). The paper's formula is not defined below the
    seabed and infinitely steep at it (erratum). The height above the seabed is therefore at least zero, and below 1 %
    of the reference height the profile is linear. Above the mean surface every profile has its value at the surface.
    """

    speed: Scalar = parameter("speed at the reference height", unit="m/s", default=0.0)
    direction: Scalar = parameter("direction of flow, +x towards +y", unit="rad", low=-6.29, high=6.29, default=0.0)
    exponent: Scalar | None = parameter("exponent of the power law", unit="-", low=0.0, default=None)
    reference: Scalar | None = parameter("height where the speed is given", unit="m", high=0.0, default=None)
    heights: Numbers | None = parameter("heights of the table, rising", unit="m", shape="table", default=None)
    velocities: Numbers | None = parameter("velocities at the heights", unit="m/s", shape="vectors", default=None)
    time: Numbers | None = parameter("times of the factor", unit="s", shape="table", default=None)
    factor: Numbers | None = parameter("factor at those times", unit="-", shape="table", default=None)
    amplitude: Numbers | None = parameter("constituents of the factor", unit="-", shape="table", default=None)
    period: Numbers | None = parameter("their periods", unit="s", shape="table", default=None)
    phase: Numbers | None = parameter("their lags", unit="rad", shape="table", default=None)
    veer: Scalar | None = parameter("turn of the direction per metre down", unit="rad/m", default=None)
    kind: str = option("profile over depth", choices=KINDS, default="uniform")

    @property
    def steady(self) -> bool:
        return self.time is None and self.amplitude is None

    def scale(self, t: Array) -> Array:
        """s(t): a table, linear between its times and constant outside, or the sum of constituents."""
        tide = harmonic(self, t)
        if tide is not None:
            return tide
        if self.time is None or self.factor is None:
            return jnp.ones_like(self.speed)
        return jnp.interp(t, self.time, self.factor)

    def profile(self, z: Array | np.ndarray, depth: Scalar) -> Array:
        """Velocity (..., 3) [m/s] at heights z (...) [m], before s(t)."""
        z = jnp.minimum(z, 0.0)
        if self.kind == "table" and self.heights is not None and self.velocities is not None:
            return jnp.stack([jnp.interp(z, self.heights, self.velocities[:, i]) for i in range(3)], axis=-1)
        size = self.speed * self._shape(z, depth)
        if self.veer is None:
            course = self.direction
        else:
            course = self.direction - self.veer * z
        return jnp.stack([size * jnp.cos(course), size * jnp.sin(course), jnp.zeros_like(z)], axis=-1)

    def _shape(self, z: Array, depth: Scalar) -> Array:
        """Speed over that at the reference height."""
        if self.kind == "uniform" or self.exponent is None or self.reference is None:
            return jnp.ones_like(z)
        share = jnp.maximum(z + depth, 0.0) / (depth + self.reference)
        inside = jnp.maximum(share, LINEAR_BELOW) ** self.exponent
        return jnp.where(share < LINEAR_BELOW, inside * share / LINEAR_BELOW, inside)

    def velocity(self, z: Array, t: Array, depth: Scalar) -> Array:
        """Velocity (n, 3) [m/s] at heights z (n,) [m] and time t [s]."""
        return self.scale(t) * self.profile(z, depth)

    def acceleration(self, z: Array, t: Array, depth: Scalar) -> Array | None:
        """Local acceleration (n, 3) [m/s^2]; None for a steady current."""
        if self.steady:
            return None
        return jax.jvp(self.scale, (t,), (jnp.ones_like(t),))[1] * self.profile(z, depth)

    def along(self, z: Array, direction: Array, depth: Scalar) -> Array:
        """Speed [m/s] along directions (c,) [rad] at heights z (c, points), for waves on the current; before s(t)."""
        u = self.profile(z, depth)
        return u[..., 0] * jnp.cos(direction)[:, None] + u[..., 1] * jnp.sin(direction)[:, None]
