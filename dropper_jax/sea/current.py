"""Currents, horizontal everywhere: uniform, power law, table over depth, each steady or scaled over time; tides."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.fields import component, option, parameter

#: One number, also of a trace.
Scalar = jax.Array | float


def harmonic(t: jax.Array, amplitude: jax.Array, period: jax.Array, phase: jax.Array) -> jax.Array:
    """`sum_i a_i cos(2 pi t/T_i - p_i)` at time t [s]; phases are lags, as in tide tables."""
    return jnp.sum(amplitude * jnp.cos(2.0 * jnp.pi * t / period - phase))


@component
class Level:
    """Height of the mean surface over z = 0, the reference level of the scene [m], and its rate.

    The water moves as with the depth `d + level` and z measured from there. Wave numbers are those of d, and the
    vertical velocity of the level (some 1e-4 m/s) is left out.
    """

    offset: Any = parameter("constant part", unit="m", default=0.0)
    time: Any = parameter("times of a table", unit="s", shape="table", default=None)
    height: Any = parameter("heights at those times", unit="m", shape="table", default=None)
    amplitude: Any = parameter("of constituents", unit="m", shape="table", default=None)
    period: Any = parameter("their periods", unit="s", shape="table", default=None)
    phase: Any = parameter("their lags", unit="rad", shape="table", default=None)

    def at(self, t: jax.Array) -> jax.Array:
        """The level [m] at time t [s]; a table is constant outside its times."""
        level = jnp.asarray(self.offset)
        if self.time is not None:
            level = level + jnp.interp(t, self.time, self.height)
        if self.amplitude is not None:
            level = level + harmonic(t, self.amplitude, self.period, self.phase)
        return level


KINDS = ("uniform", "power", "table")


@component
class Current:
    """Velocity `U(z) s(t)` along a fixed direction, or turning with depth: by `veer` or in a table.

    power: `U = speed ((d + z)/(d + reference))^exponent` (paper (4)). The paper's formula is not defined below the
    seabed and infinitely steep at it (erratum). The height above the seabed is therefore at least zero, and below 1 %
    of the reference height the profile is linear. Above the mean surface every profile has its value at the surface.
    """

    speed: Any = parameter("speed at the reference height", unit="m/s", default=0.0)
    direction: Any = parameter("direction of flow, +x towards +y", unit="rad", low=-6.29, high=6.29, default=0.0)
    exponent: Any = parameter("exponent of the power law", unit="-", low=0.0, default=None)
    reference: Any = parameter("height where the speed is given", unit="m", high=0.0, default=None)
    heights: Any = parameter("heights of the table, rising", unit="m", shape="table", default=None)
    velocities: Any = parameter("velocities at the heights", unit="m/s", shape="vectors", default=None)
    time: Any = parameter("times of the factor", unit="s", shape="table", default=None)
    factor: Any = parameter("factor at those times", unit="-", shape="table", default=None)
    amplitude: Any = parameter("constituents of the factor", unit="-", shape="table", default=None)
    period: Any = parameter("their periods", unit="s", shape="table", default=None)
    phase: Any = parameter("their lags", unit="rad", shape="table", default=None)
    veer: Any = parameter("turn of the direction per metre down", unit="rad/m", default=None)
    kind: str = option("profile over depth", choices=KINDS, default="uniform")

    @property
    def steady(self) -> bool:
        return self.time is None and self.amplitude is None

    def scale(self, t: jax.Array) -> jax.Array:
        """s(t): a table, linear between its times and constant outside, or the sum of constituents."""
        if self.amplitude is not None:
            return harmonic(t, self.amplitude, self.period, self.phase)
        if self.time is None:
            return jnp.ones_like(self.speed)
        return jnp.interp(t, self.time, self.factor)

    def profile(self, z: jax.Array | np.ndarray, depth: Scalar) -> jax.Array:
        """Velocity (..., 3) [m/s] at heights z (...) [m], before s(t)."""
        z = jnp.minimum(z, 0.0)
        if self.kind == "table":
            return jnp.stack([jnp.interp(z, self.heights, self.velocities[:, i]) for i in range(3)], axis=-1)
        size = self.speed * (jnp.ones_like(z) if self.kind == "uniform" else self._power(z, depth))
        if self.veer is None:
            course = self.direction
        else:
            course = self.direction - self.veer * z
        return jnp.stack([size * jnp.cos(course), size * jnp.sin(course), jnp.zeros_like(z)], axis=-1)

    def _power(self, z: jax.Array, depth: Scalar) -> jax.Array:
        # a power law is replaced by a linear profile below this fraction of its reference height, since its slope at
        # the seabed is infinite
        linear_below = 0.01
        share = jnp.maximum(z + depth, 0.0) / (depth + self.reference)
        inside = jnp.maximum(share, linear_below) ** self.exponent
        return jnp.where(share < linear_below, inside * share / linear_below, inside)

    def velocity(self, z: jax.Array, t: jax.Array, depth: Scalar) -> jax.Array:
        """Velocity (n, 3) [m/s] at heights z (n,) [m] and time t [s]."""
        return self.scale(t) * self.profile(z, depth)

    def acceleration(self, z: jax.Array, t: jax.Array, depth: Scalar) -> jax.Array | None:
        """Local acceleration (n, 3) [m/s^2]; None for a steady current."""
        if self.steady:
            return None
        return jax.jvp(self.scale, (t,), (jnp.ones_like(t),))[1] * self.profile(z, depth)

    def along(self, z: jax.Array, direction: jax.Array, depth: Scalar) -> jax.Array:
        """Speed along directions (c,) [rad] at heights z (c, points), for waves on the current."""
        u = self.profile(z, depth)
        return u[..., 0] * jnp.cos(direction)[:, None] + u[..., 1] * jnp.sin(direction)[:, None]
