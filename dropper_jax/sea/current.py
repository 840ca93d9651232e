"""Currents: uniform, power law, table over depth, each steady or scaled by a table over time. Horizontal everywhere."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, option, parameter


def harmonic(t: jax.Array, amplitude: jax.Array, period: jax.Array, phase: jax.Array) -> jax.Array:
    """`sum_i a_i cos(2 pi t/T_i - p_i)` at time t [s]; phases are lags, as in tide tables."""
    return jnp.sum(amplitude * jnp.cos(2.0 * jnp.pi * t / period - phase))


@component
class Level:
    """Height of the mean surface over z = 0, the reference level of the scene [m], and its rate.

    The water moves as with the depth `d + level` and z measured from there. Wave numbers are those of d, and the
    vertical velocity of the level (some 1e-4 m/s) is left out.
    """

    offset: jax.Array = parameter("constant part", unit="m", default=0.0)
    time: jax.Array | None = parameter("times of a table", unit="s", shape="table", optional=True)
    height: jax.Array | None = parameter("heights at those times", unit="m", shape="table", optional=True)
    amplitude: jax.Array | None = parameter("of constituents", unit="m", shape="table", optional=True)
    period: jax.Array | None = parameter("of constituents", unit="s", shape="table", optional=True)
    phase: jax.Array | None = parameter("lag of constituents", unit="rad", shape="table", optional=True)

    def at(self, t: jax.Array) -> jax.Array:
        """The level [m] at time t [s]; a table is constant outside its times."""
        level = jnp.asarray(self.offset)
        if self.time is not None:
            level = level + jnp.interp(t, self.time, self.height)
        if self.amplitude is not None:
            level = level + harmonic(t, self.amplitude, self.period, self.phase)
        return level


def check_constituents(values: dict[str, Any], path: str, keys: tuple[str, str, str]) -> None:
    """Reject incomplete constituents or unequal lengths; phases are 0 by default."""
    amplitude, period, phase = (values[key] for key in keys)
    if amplitude is None and period is None and phase is None:
        return
    if amplitude is None or period is None:
        missing = keys[0] if amplitude is None else keys[1]
        raise SceneError(f"{path}.{missing}: missing; constituents need `{keys[0]}` and `{keys[1]}`")
    if phase is None:
        values[keys[2]] = phase = np.zeros(len(amplitude))
    for key, value in zip(keys[1:], (period, phase), strict=True):
        if len(value) != len(amplitude):
            raise SceneError(f"{path}.{key}: has {len(value)} entries; allowed: {len(amplitude)}, one per constituent")
    if np.any(np.asarray(period) <= 0.0):
        raise SceneError(f"{path}.{keys[1]}: {float(np.min(period)):g} is out of range; allowed: > 0 s")


KINDS = ("uniform", "power", "table")


@component
class Current:
    """Velocity `U(z) s(t)` along a fixed direction, or turning with depth: by `veer` or in a table.

    power: `U = speed ((d + z)/(d + reference))^exponent` (paper (4)). The paper's formula is not defined below the
    seabed and infinitely steep at it (erratum). The height above the seabed is therefore at least zero, and below 1 %
    of the reference height the profile is linear. Above the mean surface every profile has its value at the surface.
    """

    speed: jax.Array = parameter("speed, at the reference height for a power law", unit="m/s")
    direction: jax.Array = parameter("direction of flow, from +x towards +y", unit="rad")
    exponent: jax.Array | None = parameter("exponent of the power law", unit="-", optional=True)
    reference: jax.Array | None = parameter("height where the speed is given", unit="m", optional=True)
    heights: jax.Array | None = parameter("heights of the table, z rising", unit="m", shape="table", optional=True)
    velocities: jax.Array | None = parameter("velocities at the heights", unit="m/s", shape="vectors", optional=True)
    time: jax.Array | None = parameter("times of the factor", unit="s", shape="table", optional=True)
    factor: jax.Array | None = parameter("factor of the speed at those times", unit="-", shape="table", optional=True)
    amplitude: jax.Array | None = parameter("constituents of the factor", unit="-", shape="table", optional=True)
    period: jax.Array | None = parameter("their periods", unit="s", shape="table", optional=True)
    phase: jax.Array | None = parameter("their lags", unit="rad", shape="table", optional=True)
    veer: jax.Array | None = parameter("turn of the direction per metre down", unit="rad/m", optional=True)
    kind: str = option("profile over depth", choices=KINDS, default="uniform")

    @property
    def steady(self) -> bool:
        return self.time is None and self.amplitude is None

    def scale(self, t: jax.Array) -> jax.Array:
        """s(t): a table, linear between its times and constant outside, or the sum of constituents."""
        if self.amplitude is not None:
            return harmonic(t, self.amplitude, self.period, self.phase)
        return jnp.ones_like(self.speed) if self.time is None else jnp.interp(t, self.time, self.factor)

    def profile(self, z: jax.Array, depth: jax.Array) -> jax.Array:
        """Velocity (..., 3) [m/s] at heights z (...) [m], before s(t)."""
        z = jnp.minimum(z, 0.0)
        if self.kind == "table":
            columns = [jnp.interp(z, self.heights, self.velocities[:, i]) for i in range(3)]
            return jnp.stack(columns, axis=-1)
        size = self.speed * (jnp.ones_like(z) if self.kind == "uniform" else self._power(z, depth))
        course = self.direction if self.veer is None else self.direction - self.veer * z
        return jnp.stack([size * jnp.cos(course), size * jnp.sin(course), jnp.zeros_like(z)], axis=-1)

    def _power(self, z: jax.Array, depth: jax.Array) -> jax.Array:
        # a power law is replaced by a linear profile below this fraction of its reference height, since its slope at
        # the seabed is infinite
        linear_below = 0.01
        share = jnp.maximum(z + depth, 0.0) / (depth + self.reference)
        inside = jnp.maximum(share, linear_below) ** self.exponent
        return jnp.where(share < linear_below, inside * share / linear_below, inside)

    def velocity(self, z: jax.Array, t: jax.Array, depth: jax.Array) -> jax.Array:
        """Velocity (n, 3) [m/s] at heights z (n,) [m] and time t [s]."""
        return self.scale(t) * self.profile(z, depth)

    def acceleration(self, z: jax.Array, t: jax.Array, depth: jax.Array) -> jax.Array | None:
        """Local acceleration (n, 3) [m/s^2]; None for a steady current."""
        if self.steady:
            return None
        rate = jax.jvp(self.scale, (t,), (jnp.ones_like(t),))[1]
        return rate * self.profile(z, depth)

    def along(self, z: jax.Array, direction: jax.Array, depth: jax.Array) -> jax.Array:
        """Speed along directions (c,) [rad] at heights z (c, points), for waves on the current."""
        u = self.profile(z, depth)
        return u[..., 0] * jnp.cos(direction)[:, None] + u[..., 1] * jnp.sin(direction)[:, None]
