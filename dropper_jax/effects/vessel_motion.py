"""Points on barges and vessels that move in waves, or by a table, regardless of the lines."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.fields import component, option, parameter
from dropper_jax.effects.end_motion import interpolate_quintic
from dropper_jax.model import Effect
from dropper_jax.sea import Sea


def rigid_displacement(motion: Array, arm: Array, heading: Array) -> Array:
    """Displacement (3,) [m] of a position `arm` (3,) on a vessel by its motion (6,): translations [m] and rotations
    [rad].

    `x = d + R s - s` with `R = Rz(yaw) Ry(pitch) Rx(roll)`, all in the vessel's axes, then rotated by its heading.
    """
    sx, sy, sz = jnp.sin(motion[3:])
    cx, cy, cz = jnp.cos(motion[3:])
    x, y, z = arm
    y, z = cx * y - sx * z, sx * y + cx * z
    x, z = cy * x + sy * z, cy * z - sy * x
    x, y = cz * x - sz * y, sz * x + cz * y
    x, y, z = motion[:3] + jnp.stack([x, y, z]) - arm
    c = jnp.cos(heading)
    s = jnp.sin(heading)
    return jnp.stack([c * x - s * y, s * x + c * y, z])


@component
class VesselInWaves(Effect):
    """First-order motion of a point on a vessel: `q_j = sum_c a_c |H_jc| cos(p_c - phi_jc)`, phi leading.

    p are the phases of the waves at the vessel's mean position (its reference point). The vessel neither drifts nor
    follows a level of the sea, and its motion does not depend on the lines.
    """

    name = "vessel_motion"
    needs_sea = True
    real: Array = parameter("H of each component, in phase (c, 6)", unit="-", shape="vectors")
    imaginary: Array = parameter("H of each component, a quarter period ahead (c, 6)", unit="-", shape="vectors")
    position: Array = parameter("mean position of the reference point", unit="m", shape="vector")
    arm: Array = parameter("the point in the vessel's axes", unit="m", shape="vector")
    heading: Array = parameter("direction of the vessel's x-axis", unit="rad")
    ramp_times: Array = parameter("start and end of the sea's ramp", unit="s", shape="table")
    point: str = option("name of the point", type=str, default="")

    @property
    def kinks(self) -> Array | None:
        return self.ramp_times

    def displace(self, t: Array, sea: Sea) -> Array:
        """Displacement (3,) [m] at time t [s]."""
        if sea.waves is None:
            return jnp.zeros_like(self.position)
        waves = sea.waves
        phases = waves.phases(self.position[:1], self.position[1:2], t)[0]
        size = (waves.rise(t)[0] * waves.amplitude)[:, None]
        cos = jnp.cos(phases)[:, None]
        sin = jnp.sin(phases)[:, None]
        motion = jnp.sum(size * (cos * self.real + sin * self.imaginary), axis=0)
        return rigid_displacement(motion, self.arm, self.heading)


@component
class VesselByTable(Effect):
    """Motion of a point on a vessel by a table (k, 6) at times (k,), with quintics between the rows as in
    `end_motion`."""

    name = "vessel_motion"
    time: Array = parameter("times", unit="s", shape="table")
    motion: Array = parameter("surge, sway, heave, roll, pitch, yaw (k, 6)", unit="-", shape="vectors")
    arm: Array = parameter("the point in the vessel's axes", unit="m", shape="vector")
    heading: Array = parameter("direction of the vessel's x-axis", unit="rad")
    point: str = option("name of the point", type=str, default="")

    @property
    def kinks(self) -> Array | None:
        return self.time[jnp.array([0, -1])]

    @property
    def corners(self) -> Array | None:
        return self.time

    def displace(self, t: Array) -> Array:
        """Displacement (3,) [m] at time t [s]."""
        return rigid_displacement(interpolate_quintic(t, self.time, self.motion), self.arm, self.heading)
