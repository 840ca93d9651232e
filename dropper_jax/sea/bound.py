"""Kinematics of one steady wave of finite height: bound harmonics (`sea.steady`)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.trigonometry import sincos
from dropper_jax.sea.steady import SteadyWave
from dropper_jax.sea.waves import Waves

#: Harmonics with a crest velocity below this fraction of that of the first are left out.
SMALL = 1e-9


@component
class BoundWaves(Waves):
    """The harmonics j = 1..n of a wave: `amplitude` E_j, `omega` j w, `wave_number` j k, `phase` j e.

        eta = sum_j E_j cos j p,    u = drift + sum_j V_j cosh jk(z + d)/sinh jkd cos j p,    p = k s - w t + e

    The accelerations are the exact time derivatives. The field is valid up to the surface, so no stretching is used.
    Above the surface and below the seabed the values at the boundary are used.

    Attributes:
        speed: V_j = U_j tanh jkd, (n,) [m/s].
        drift: uniform flow of the wave [m/s]: c_E minus the current, if the mean transport is given.
        flow, head: U and Bernoulli's constant in the frame of the wave (`steady.SteadyWave`).
    """

    speed: jax.Array = parameter("velocity of the harmonics", unit="m/s", shape="table", default=None)
    drift: jax.Array | None = parameter("uniform flow of the wave", unit="m/s", optional=True)
    flow: jax.Array = parameter("mean speed in the frame of the wave", unit="m/s", default=None)
    head: jax.Array = parameter("Bernoulli's constant", unit="m^2/s^2", default=None)
    theory: str = option("theory of the wave", type=str, default="stream")

    @property
    def bound(self) -> bool:
        return True

    @property
    def speeds(self) -> jax.Array:
        return self.speed

    @property
    def shortest(self) -> jax.Array:
        """Length of the wave [m] (not of its harmonics)."""
        return 2.0 * jnp.pi / self.wave_number[0]

    @property
    def height(self) -> jax.Array:
        """From trough to crest [m]."""
        return 2.0 * jnp.sum(self.amplitude[::2])

    @property
    def significant_height(self) -> jax.Array:
        """`4 sqrt(m0)` [m]."""
        return 4.0 * jnp.sqrt(0.5 * jnp.sum(self.amplitude**2))

    def heights(self, z: jax.Array, elevation: jax.Array, depth: jax.Array) -> jax.Array:
        """Height at which the kinematics of z are evaluated (n,) [m]: z limited to the range from seabed to surface."""
        return jnp.maximum(jnp.minimum(z, elevation), -depth)

    def _orbit(self, z: jax.Array, cos: jax.Array, sin: jax.Array, depth: jax.Array) -> tuple[jax.Array, jax.Array]:
        velocity, acceleration = super()._orbit(z, cos, sin, depth)
        if self.drift is None:
            return velocity, acceleration
        course = jnp.stack([jnp.cos(self.direction), jnp.sin(self.direction), jnp.zeros_like(self.direction)])
        return velocity + self.drift * course, acceleration

    def pressure(self, r: jax.Array, t: jax.Array, depth: jax.Array, density: jax.Array) -> jax.Array:
        """Pressure (n,) [Pa] minus the hydrostatic one, by Bernoulli: zero at a surface of height `rho g eta`."""
        sin, cos = sincos(self.phases(r[:, 0], r[:, 1], t))
        elevation = jnp.sum(self.amplitude * cos, axis=-1)
        across, upright = self.profiles(self.heights(r[:, 2], elevation, depth), depth)
        u = jnp.sum(across * cos * self.speed, axis=-1) - self.flow
        w = jnp.sum(upright * sin * self.speed, axis=-1)
        return density * (self.head - 0.5 * (u**2 + w**2))


def bound_waves(
    wave: SteadyWave, phase: float, direction: float, current: float, ramp: float | None = None
) -> BoundWaves:
    """The arrays of a solved wave.

    Args:
        phase: e [rad]; the crest is at `k s = w t - e`.
        current: part of the mean Eulerian velocity that the current of the sea already includes [m/s].
    """
    k, order = wave.wave_number, np.arange(1, wave.order + 1)
    tanh = np.tanh(order * k * wave.depth)
    size = np.abs(wave.speed) * np.exp(order * k * wave.crest)
    kept = max(int(np.max(np.flatnonzero(size > SMALL * size[0]))), 1) + 1
    kept = max(kept, int(np.max(np.flatnonzero(np.abs(wave.surface) > SMALL * wave.height))) + 1)
    order, drift = order[:kept], wave.eulerian - current
    return BoundWaves(
        amplitude=jnp.asarray(wave.surface[:kept]),
        omega=jnp.asarray(2.0 * np.pi / wave.period * order),
        wave_number=jnp.asarray(k * order),
        phase=jnp.asarray(phase * order, float),
        direction=jnp.asarray(direction, float),
        ramp=ramp,
        stretching="none",
        speed=jnp.asarray((wave.speed * tanh)[:kept]),
        drift=None if abs(drift) < 1e-12 else jnp.asarray(drift),
        flow=jnp.asarray(wave.flow),
        head=jnp.asarray(wave.head),
        theory=wave.theory,
    )
