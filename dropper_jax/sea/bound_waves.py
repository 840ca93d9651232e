"""A steady wave of finite height as bound harmonics: components of multiples of one frequency and one wave number."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.fields import component, option, parameter
from dropper_jax.sea.current import Scalar
from dropper_jax.sea.steady import SteadyWave
from dropper_jax.sea.waves import Waves


@component
class BoundWaves(Waves):
    """The harmonics j = 1..n of a wave: `amplitude` E_j, `omega` j w, `wave_number` j k, `phase` j e.

        eta = sum_j E_j cos j p,    u = drift + sum_j V_j cosh jk(z + d)/sinh jkd cos j p,    p = k s - w t + e

    The accelerations are the exact time derivatives. The field is valid up to the surface, so no stretching is used.
    Above the surface and below the seabed the values at the boundary are used.

    Attributes:
        speed: V_j = U_j tanh jkd, (n,) [m/s].
        drift: uniform flow of the wave [m/s]: c_E minus the current, if the mean transport is given.
    """

    speed: Array = parameter("velocity of the harmonics", unit="m/s", shape="table", default=None)
    drift: Array | None = parameter("uniform flow of the wave", unit="m/s", default=None)
    theory: str = option("theory of the wave", type=str, default="stream")

    @property
    def bound(self) -> bool:
        return True

    @property
    def speeds(self) -> Array:
        return self.speed

    @property
    def shortest(self) -> Array:
        """Length of the wave [m] (not of its harmonics)."""
        return 2.0 * jnp.pi / self.wave_number[0]

    @property
    def height(self) -> Array:
        """From trough to crest [m]."""
        return 2.0 * jnp.sum(self.amplitude[::2])

    def heights(self, z: Array, elevation: Array, depth: Scalar) -> Array:
        """Height at which the kinematics of z are evaluated (n,) [m]: z limited to the range from seabed to surface."""
        return jnp.maximum(jnp.minimum(z, elevation), -depth)

    def _orbit(self, z: Array, cos: Array, sin: Array, depth: Scalar) -> tuple[Array, Array]:
        velocity, acceleration = super()._orbit(z, cos, sin, depth)
        if self.drift is None:
            return velocity, acceleration
        course = jnp.stack([*self.course, jnp.zeros_like(self.direction)])
        return velocity + self.drift * course, acceleration


#: Uniform flow [m/s] below which that of a wave is rounding, and adds no computation.
RESTING_DRIFT = 1e-12
#: Harmonics are left out if both their velocity at the crest, over that of the first, and their elevation, over the
#: height, are below this fraction.
NEGLIGIBLE = 1e-9


def bound_waves(
    wave: SteadyWave, phase: float, direction: float, current: float, ramp: float | None = None
) -> BoundWaves:
    """The arrays of a solved wave.

    Args:
        phase: e [rad]; the crest is at `k s = w t - e`.
        current: part of the mean Eulerian velocity that the current of the sea already includes [m/s].
    """
    k = wave.wave_number
    order = np.arange(1, wave.order + 1)
    speed = wave.speed * np.tanh(order * k * wave.depth)
    at_crest = np.abs(wave.speed) * np.exp(order * k * wave.crest)
    counts = (at_crest > NEGLIGIBLE * at_crest[0]) | (np.abs(wave.surface) > NEGLIGIBLE * wave.height)
    count = max(int(np.max(order[counts])), 2)
    order = order[:count]
    drift = None
    if abs(wave.eulerian - current) >= RESTING_DRIFT:
        drift = jnp.asarray(wave.eulerian - current)
    return BoundWaves(
        amplitude=jnp.asarray(wave.surface[:count]),
        omega=jnp.asarray(2.0 * np.pi / wave.period * order),
        wave_number=jnp.asarray(k * order),
        phase=jnp.asarray(phase * order, float),
        direction=jnp.asarray(direction, float),
        ramp=ramp,
        stretching="none",
        speed=jnp.asarray(speed[:count]),
        drift=drift,
        theory=wave.theory,
    )
