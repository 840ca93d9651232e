"""Currents: uniform, power law, table over depth, each steady or scaled by a table over time. Horizontal everywhere."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from dropper_jax.base.fields import component, option, parameter
from dropper_jax.sea.tide import harmonic

KINDS = ("uniform", "power", "table")

#: A power law is replaced by a linear profile below this fraction of its reference height, since its slope at the
#: seabed is infinite.
LINEAR_BELOW = 0.01


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
        share = jnp.maximum(z + depth, 0.0) / (depth + self.reference)
        inside = jnp.maximum(share, LINEAR_BELOW) ** self.exponent
        return jnp.where(share < LINEAR_BELOW, inside * share / LINEAR_BELOW, inside)

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
