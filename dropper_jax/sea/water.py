"""Water at the nodes, frozen over a step: the sea as a part of the model, its currents, and its state for effects."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import trace_once
from dropper_jax.sea.waves import Motion

# --- currents, horizontal everywhere: uniform, power law, table over depth, each steady or scaled over time ---


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
    time: Any = parameter("times of a table", unit="s", shape="table", optional=True)
    height: Any = parameter("heights at those times", unit="m", shape="table", optional=True)
    amplitude: Any = parameter("of constituents", unit="m", shape="table", optional=True)
    period: Any = parameter("their periods", unit="s", shape="table", optional=True)
    phase: Any = parameter("their lags", unit="rad", shape="table", optional=True)

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
    exponent: Any = parameter("exponent of the power law", unit="-", low=0.0, optional=True)
    reference: Any = parameter("height where the speed is given", unit="m", high=0.0, optional=True)
    heights: Any = parameter("heights of the table, rising", unit="m", shape="table", optional=True)
    velocities: Any = parameter("velocities at the heights", unit="m/s", shape="vectors", optional=True)
    time: Any = parameter("times of the factor", unit="s", shape="table", optional=True)
    factor: Any = parameter("factor at those times", unit="-", shape="table", optional=True)
    amplitude: Any = parameter("constituents of the factor", unit="-", shape="table", optional=True)
    period: Any = parameter("their periods", unit="s", shape="table", optional=True)
    phase: Any = parameter("their lags", unit="rad", shape="table", optional=True)
    veer: Any = parameter("turn of the direction per metre down", unit="rad/m", optional=True)
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
            return jnp.stack([jnp.interp(z, self.heights, self.velocities[:, i]) for i in range(3)], axis=-1)
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
        return jax.jvp(self.scale, (t,), (jnp.ones_like(t),))[1] * self.profile(z, depth)

    def along(self, z: jax.Array, direction: jax.Array, depth: jax.Array) -> jax.Array:
        """Speed along directions (c,) [rad] at heights z (c, points), for waves on the current."""
        u = self.profile(z, depth)
        return u[..., 0] * jnp.cos(direction)[:, None] + u[..., 1] * jnp.sin(direction)[:, None]


@component
class Sea:
    """Water of constant depth below z = 0, the mean surface, with waves and current if given."""

    depth: jax.Array = parameter("depth of the water", unit="m", low=0.0, open_low=True)
    density: jax.Array = parameter("density of the water", unit="kg/m^3", low=0.0, open_low=True, default=SEA_WATER)
    gravity: jax.Array = parameter("acceleration of gravity", unit="m/s^2", low=0.0, open_low=True, default=GRAVITY)
    waves: Any = None
    current: Current | None = None
    level: Level | None = None

    def over(self, r: jax.Array, t: jax.Array) -> tuple[Sea, jax.Array, jax.Array]:
        """The water of the level at time t, positions r (n, 3) relative to it, and the level [m]."""
        level = self.level.at(t)
        return replace(self, depth=self.depth + level, level=None), r.at[..., 2].add(-level), level

    @trace_once
    def elevation(self, r: jax.Array, t: jax.Array) -> jax.Array:
        """Elevation of the surface (n,) [m] over positions r (n, 3)."""
        if self.level is not None:
            own, r, level = self.over(r, t)
            return own.elevation(r, t) + level
        if self.waves is None:
            return jnp.zeros_like(r[:, 0])
        return self.waves.elevation(r[:, 0], r[:, 1], t)

    @trace_once
    def at(self, r: jax.Array, t: jax.Array) -> Motion:
        """Water at positions r (n, 3) [m]; the acceleration is the local one, du/dt at a fixed position."""
        if self.level is not None:
            own, r, level = self.over(r, t)
            motion = own.at(r, t)
            return motion._replace(elevation=motion.elevation + level)
        if self.waves is None:
            motion = Motion(jnp.zeros_like(r[:, 0]), jnp.zeros_like(r), jnp.zeros_like(r))
        else:
            motion = self.waves.motion(r, t, self.depth)
        velocity, acceleration = motion.velocity, motion.acceleration
        if self.current is not None:
            velocity = velocity + self.current.velocity(r[:, 2], t, self.depth)
            change = self.current.acceleration(r[:, 2], t, self.depth)
            acceleration = acceleration if change is None else acceleration + change
        return Motion(motion.elevation, velocity, acceleration)

    @trace_once
    def convective(self, r: jax.Array, t: jax.Array, motion: Motion) -> jax.Array:
        """`(u . grad) u` (n, 3) [m/s^2], the difference between Du/Dt and the local acceleration.

        It is that of the unstretched field, at the heights at which the kinematics are evaluated.
        """
        if self.level is not None:
            own, r, level = self.over(r, t)
            return own.convective(r, t, motion._replace(elevation=motion.elevation - level))
        if self.waves is not None:
            heights = self.waves.heights(r[:, 2], motion.elevation, self.depth)
            r = jnp.concatenate([r[:, :2], heights[:, None]], axis=1)

        def field(position: jax.Array) -> jax.Array:
            total = jnp.zeros_like(position)
            if self.waves is not None:
                total = total + self.waves.airy_velocity(position, t, self.depth)
            if self.current is not None:
                total = total + self.current.velocity(position[:, 2], t, self.depth)
            return total

        return jax.jvp(field, (r,), (motion.velocity,))[1]

    def stream(self, r: jax.Array, t: jax.Array) -> jax.Array:
        """Velocity (n, 3) [m/s] of the current alone."""
        if self.level is not None:
            own, r, _ = self.over(r, t)
            return own.stream(r, t)
        return jnp.zeros_like(r) if self.current is None else self.current.velocity(r[:, 2], t, self.depth)

    @property
    def corners(self) -> list[jax.Array]:
        """Times (k,) [s] at which the motion of the water is not smooth: table times of the current, both ends of a
        ramp."""
        tables = [part.time for part in (self.current, self.level) if part is not None and part.time is not None]
        ramp = None if self.waves is None else self.waves.ramp
        return tables if ramp is None else [*tables, jnp.stack([jnp.zeros_like(ramp), ramp])]

    def without_waves(self) -> Sea:
        """The same water without waves."""
        return replace(self, waves=None)

    def water(self, r: jax.Array, t: jax.Array, tangents: jax.Array, material: bool, current: bool = False) -> Water:
        """Water around nodes r (nodes, 3) [m] of links along `tangents` (n, 3), for effects.

        Du/Dt with `material`, the velocity of the current alone with `current`.
        """
        motion = self.at(r, t)
        change = motion.acceleration + self.convective(r, t, motion) if material else None
        return Water(motion, change, tangents, self.stream(r, t) if current else None)


class Water(NamedTuple):
    """Water of a step, evaluated once at its predicted midpoint.

    Attributes:
        motion: elevation, velocity, local acceleration at the free nodes.
        material: Du/Dt there (None if no effect needs it).
        tangents: of the links (n, 3).
        current: velocity of the current alone (None if no effect needs it).
    """

    motion: Motion
    material: jax.Array | None
    tangents: jax.Array
    current: jax.Array | None = None
