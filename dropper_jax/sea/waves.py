"""Linear (Airy) waves in finite depth: elevation, velocity and acceleration of the water at given positions.

With `p = k (x cos m + y sin m) - w t + e` and s the intrinsic frequency (w without a current), per component

    eta = a cos p,    u = a s C cos p (cos m, sin m),    u_z = a s S sin p,    u' = d/dt at a fixed position
    C = cosh k(z + d)/sinh kd,    S = sinh k(z + d)/sinh kd

(thesis (6.4)-(6.9), where (C.30) lacks the minus sign of u'_z and (C.25)-(C.30) lack phase and sum; paper (7)-(13)).
Exponentials are evaluated only of -kd and of k z, so that kd = 95 does not overflow in float32.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.fields import component, option, parameter
from dropper_jax.sea.current import Scalar
from dropper_jax.sea.sincos import sincos

#: Extrapolation of kinematics above the mean surface, where linear theory is not defined.
STRETCHING = ("none", "constant", "wheeler")
#: Maximum k z at which unstretched kinematics are evaluated, six wavelengths above the surface: velocities of nodes in
#: the air, which carry no force, are finite in float32 too, and so are their squares.
MAX_RISE = 40.0


class Motion(NamedTuple):
    """Water at some positions: elevation (n,) [m], velocity and local acceleration (n, 3) [m/s], [m/s^2]."""

    elevation: Array
    velocity: Array
    acceleration: Array


@component
class Waves:
    """A sum of wave components (c,). Wave numbers and intrinsic frequencies are solved once, when the sea is made."""

    amplitude: Array = parameter("amplitude", unit="m", shape="table", low=0.0)
    omega: Array = parameter("absolute angular frequency", unit="rad/s", shape="table")
    wave_number: Array = parameter("wave number", unit="rad/m", shape="table")
    phase: Array = parameter("phase", unit="rad", shape="table")
    direction: Array = parameter("direction of travel from +x towards +y: one, or one per component", unit="rad")
    intrinsic: Array | None = parameter("intrinsic frequency on a current", unit="rad/s", default=None)
    ramp: Scalar | None = parameter("time to reach the full height", unit="s", low=0.0, default=None)
    stretching: str = option("kinematics above the mean surface", choices=STRETCHING, default="wheeler")

    @property
    def size(self) -> int:
        return self.amplitude.shape[-1]

    @property
    def bound(self) -> bool:
        """Whether the components are harmonics of one wave."""
        return False

    @property
    def speeds(self) -> Array:
        """Factor of the profiles of a component for its velocity (c,) [m/s]: `a s`; s is omega without a current."""
        if self.intrinsic is None:
            return self.amplitude * self.omega
        return self.amplitude * self.intrinsic

    @property
    def peak_period(self) -> Array:
        """Period of the component with the largest amplitude [s]."""
        return 2.0 * jnp.pi / self.omega[jnp.argmax(self.amplitude)]

    @property
    def shortest(self) -> Array:
        """Length of the shortest waves [m]."""
        return 2.0 * jnp.pi / jnp.max(self.wave_number)

    def rise(self, t: Array) -> tuple[Array, Array]:
        """Ramp factor `sin^2(pi t/(2 ramp))` and its rate [1/s]."""
        if self.ramp is None:
            return jnp.ones((), self.amplitude.dtype), jnp.zeros((), self.amplitude.dtype)
        angle = jnp.pi * jnp.clip(t / self.ramp, 0.0, 1.0)
        return 0.5 * (1.0 - jnp.cos(angle)), 0.5 * jnp.pi / self.ramp * jnp.sin(angle)

    @property
    def course(self) -> tuple[Array, Array]:
        """Cosine and sine of the direction."""
        return jnp.cos(self.direction), jnp.sin(self.direction)

    def phases(self, x: Array, y: Array, t: Array) -> Array:
        """p of each component (n, c) [rad] at x, y (n,) [m]."""
        rest = self.phase - self.omega * t
        cos, sin = self.course
        if self.direction.ndim == 0:
            return (x * cos + y * sin)[:, None] * self.wave_number + rest
        return x[:, None] * (self.wave_number * cos) + y[:, None] * (self.wave_number * sin) + rest

    def elevation(self, x: Array, y: Array, t: Array) -> Array:
        """Surface elevation (n,) [m]."""
        return self.rise(t)[0] * jnp.sum(self.amplitude * sincos(self.phases(x, y, t))[1], axis=-1)

    def heights(self, z: Array, elevation: Array, depth: Scalar) -> Array:
        """Height at which the kinematics of z are evaluated (n,) [m]: z, z limited to the mean surface, or Wheeler's
        z'.

        Wheeler (1970): `z' = d (z - eta)/(d + eta)`. Velocity and local acceleration are mapped separately, so one is
        not the time derivative of the other. Heights are limited to the range from seabed to surface.
        """
        if self.stretching == "wheeler":
            z = depth * (z - elevation) / (depth + elevation)
        if self.stretching != "none":
            z = jnp.minimum(z, 0.0)
        return jnp.maximum(z, -depth)

    def profiles(self, z: Array, depth: Scalar) -> tuple[Array, Array]:
        """C and S of each component at heights z (n,): (n, c) each."""
        k = self.wave_number
        up = jnp.exp(jnp.minimum(k * z[:, None], MAX_RISE))
        down = jnp.exp(-k * (z[:, None] + 2.0 * depth))
        scale = -1.0 / jnp.expm1(-2.0 * k * depth)
        return (up + down) * scale, (up - down) * scale

    def motion(self, r: Array, t: Array, depth: Scalar) -> Motion:
        """The water at positions r (n, 3) [m], all components in one pass."""
        sin, cos = sincos(self.phases(r[:, 0], r[:, 1], t))
        rise, rate = self.rise(t)
        elevation = rise * jnp.sum(self.amplitude * cos, axis=-1)
        velocity, acceleration = self._orbit(self.heights(r[:, 2], elevation, depth), cos, sin, depth)
        return Motion(elevation, rise * velocity, rise * acceleration + rate * velocity)

    def _orbit(self, z: Array, cos: Array, sin: Array, depth: Scalar) -> tuple[Array, Array]:
        """Velocity and local acceleration (n, 3) at heights z, without the ramp."""
        across, upright = self.profiles(z, depth)
        speed = self.speeds
        along = self.omega * speed
        return self._vector(across * cos, speed, upright * sin), self._vector(across * sin, along, -upright * cos)

    def _vector(self, level: Array, size: Array, rising: Array) -> Array:
        """Sum over the components of level and vertical parts (n, c) times size (c,), as (n, 3)."""
        vertical = jnp.sum(rising * size, axis=-1)
        cos, sin = self.course
        if self.direction.ndim == 0:
            total = jnp.sum(level * size, axis=-1)
            return jnp.stack([total * cos, total * sin, vertical], axis=-1)
        x = jnp.sum(level * (size * cos), axis=-1)
        y = jnp.sum(level * (size * sin), axis=-1)
        return jnp.stack([x, y, vertical], axis=-1)

    def airy_velocity(self, r: Array, t: Array, depth: Scalar) -> Array:
        """Velocity (n, 3) [m/s] at positions r with mapped heights, for gradients."""
        sin, cos = sincos(self.phases(r[:, 0], r[:, 1], t))
        return self.rise(t)[0] * self._orbit(r[:, 2], cos, sin, depth)[0]

    def excursion(self, position: Array, t: Array, depth: Scalar, heave: Array, surge: Array) -> Array:
        """Displacement (3,) [m] of a particle at the mean surface, its parts times `heave` and `surge`."""
        phases = self.phases(position[:1], position[1:2], t)[0]
        across = self.speeds / (self.omega * jnp.tanh(self.wave_number * depth)) * surge * -jnp.sin(phases)
        cos, sin = self.course
        up = self.amplitude * heave * jnp.cos(phases)
        return self.rise(t)[0] * jnp.stack([jnp.sum(across * cos), jnp.sum(across * sin), jnp.sum(up)])

    @property
    def significant_height(self) -> Array:
        """`Hs = 4 sqrt(m0)` [m]."""
        return 4.0 * jnp.sqrt(0.5 * jnp.sum(self.amplitude**2))
