"""Water at the nodes, frozen over a step: the sea as a part of the model, its currents, and its state for effects."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.fields import component, parameter
from dropper_jax.base.numerics import trace_once
from dropper_jax.sea.current import Current, Level, Numbers, Scalar
from dropper_jax.sea.waves import Motion


@component
class Sea:
    """Water of constant depth below z = 0, the mean surface, with waves and current if given."""

    depth: Scalar = parameter("depth of the water", unit="m", above=0.0)
    density: Scalar = parameter("density of the water", unit="kg/m^3", above=0.0, default=SEA_WATER)
    gravity: Scalar = parameter("acceleration of gravity", unit="m/s^2", above=0.0, default=GRAVITY)
    waves: Any = None  # Waves or None; an effect that uses them has checked that the sea has some
    current: Current | None = None
    level: Level | None = None

    def _at_level(self, surface: Level, r: Array, t: Array) -> tuple[Sea, Array, Array]:
        """The water below the level at time t, positions r (n, 3) relative to the level, and the level [m]."""
        level = surface.at(t)
        return replace(self, depth=self.depth + level, level=None), r.at[..., 2].add(-level), level

    @trace_once
    def elevation(self, r: Array, t: Array) -> Array:
        """Elevation of the surface (n,) [m] over positions r (n, 3)."""
        if self.level is not None:
            own, r, level = self._at_level(self.level, r, t)
            return own.elevation(r, t) + level
        if self.waves is None:
            return jnp.zeros_like(r[:, 0])
        return self.waves.elevation(r[:, 0], r[:, 1], t)

    @trace_once
    def at(self, r: Array, t: Array) -> Motion:
        """Water at positions r (n, 3) [m]; the acceleration is the local one, du/dt at a fixed position."""
        if self.level is not None:
            own, r, level = self._at_level(self.level, r, t)
            motion = own.at(r, t)
            return motion._replace(elevation=motion.elevation + level)
        if self.waves is None:
            motion = Motion(jnp.zeros_like(r[:, 0]), jnp.zeros_like(r), jnp.zeros_like(r))
        else:
            motion = self.waves.motion(r, t, self.depth)
        velocity = motion.velocity
        acceleration = motion.acceleration
        if self.current is not None:
            velocity = velocity + self.current.velocity(r[:, 2], t, self.depth)
            change = self.current.acceleration(r[:, 2], t, self.depth)
            if change is not None:
                acceleration = acceleration + change
        return Motion(motion.elevation, velocity, acceleration)

    @trace_once
    def convective(self, r: Array, t: Array, motion: Motion) -> Array:
        """`(u . grad) u` (n, 3) [m/s^2], the difference between Du/Dt and the local acceleration.

        It is that of the unstretched field, at the heights at which the kinematics are evaluated.
        """
        if self.level is not None:
            own, r, level = self._at_level(self.level, r, t)
            return own.convective(r, t, motion._replace(elevation=motion.elevation - level))
        if self.waves is not None:
            heights = self.waves.heights(r[:, 2], motion.elevation, self.depth)
            r = jnp.concatenate([r[:, :2], heights[:, None]], axis=1)

        def field(position: Array) -> Array:
            total = jnp.zeros_like(position)
            if self.waves is not None:
                total = total + self.waves.airy_velocity(position, t, self.depth)
            if self.current is not None:
                total = total + self.current.velocity(position[:, 2], t, self.depth)
            return total

        return jax.jvp(field, (r,), (motion.velocity,))[1]

    def stream(self, r: Array, t: Array) -> Array:
        """Velocity (n, 3) [m/s] of the current alone."""
        if self.level is not None:
            own, r, _ = self._at_level(self.level, r, t)
            return own.stream(r, t)
        if self.current is None:
            return jnp.zeros_like(r)
        return self.current.velocity(r[:, 2], t, self.depth)

    @property
    def corners(self) -> list[Numbers]:
        """Times (k,) [s] at which the motion of the water is not smooth: table times of the current, both ends of a
        ramp."""
        found = []
        for part in (self.current, self.level):
            if part is not None and part.time is not None:
                found.append(part.time)
        if self.waves is not None and self.waves.ramp is not None:
            found.append(jnp.stack([jnp.zeros_like(self.waves.ramp), self.waves.ramp]))
        return found

    def without_waves(self) -> Sea:
        """The same water without waves."""
        return replace(self, waves=None)

    def water(self, r: Array, t: Array, tangents: Array, material: bool, current: bool = False) -> Water:
        """Water around nodes r (nodes, 3) [m] of links along `tangents` (n, 3), for effects.

        Du/Dt with `material`, the velocity of the current alone with `current`.
        """
        water = Water(self.at(r, t), None, tangents)
        if material:
            motion = water.motion
            water = water._replace(material=motion.acceleration + self.convective(r, t, motion))
        if current:
            water = water._replace(current=self.stream(r, t))
        return water


class Water(NamedTuple):
    """Water of a step, evaluated once at its predicted midpoint.

    Attributes:
        motion: elevation, velocity, local acceleration at the free nodes.
        material: Du/Dt there (None if no effect needs it).
        tangents: of the links (n, 3).
        current: velocity of the current alone (None if no effect needs it).
    """

    motion: Motion
    material: Array | None
    tangents: Array
    current: Array | None = None
