"""Prescribed motion of an end: harmonic or from a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.model import HeldMotion
from dropper_jax.scene import SceneData


@component
class EndMotion(HeldMotion):
    """Displacement of a held point, and of others that move with it (a vessel's), from their positions.

    Harmonic: `x(t) = s(t) a sin(2 pi t / period + phase)`, with `s(t) = u^2 (3 - 2 u)`, `u = min(t/ramp, 1)` where a
    ramp is given: a linear one would start and end with a jump of the velocity.
    Table: `displacement` (k, 3) at `time`, a smooth cubic (Catmull-Rom) between, so that velocities exist.
    """

    name: ClassVar[str] = "end_motion"
    amplitude: jax.Array | None = parameter("amplitude per axis", unit="m", shape="vector", optional=True)
    period: jax.Array | None = parameter("period", unit="s", low=0.0, open_low=True, optional=True)
    phase: jax.Array | None = parameter("phase", unit="rad", optional=True)
    ramp: jax.Array | None = parameter(
        "time to reach the full amplitude", unit="s", low=0.0, open_low=True, optional=True
    )
    time: jax.Array | None = parameter("times of the table", unit="s", shape="table", optional=True)
    displacement: jax.Array | None = parameter("displacement at those times", unit="m", shape="vectors", optional=True)
    point: str = option("name of the point that moves", type=str, default="")
    also: tuple[str, ...] = option("further points that move with it", type=list, default=())

    @classmethod
    def check(cls, values: Mapping[str, Any], scene: SceneData) -> None:
        cls.check_points(values, scene)
        harmonic = values["amplitude"] is not None and values["period"] is not None
        table = values["time"] is not None and values["displacement"] is not None
        if harmonic == table:
            raise SceneError("effects.end_motion: give either `amplitude` and `period`, or `time` and `displacement`")
        if table and (
            len(values["time"]) != len(values["displacement"])
            or len(values["time"]) < 2
            or np.any(np.diff(values["time"]) <= 0)
        ):
            raise SceneError("effects.end_motion.time: needs at least 2 increasing times, one per displacement")

    def displace(self, t: jax.Array) -> jax.Array:
        """Displacement (3,) [m] at time t [s]."""
        if self.time is not None:
            return _catmull_rom(t, self.time, self.displacement)
        phase = 0.0 if self.phase is None else self.phase
        wave = jnp.sin(2 * jnp.pi * t / self.period + phase)
        if self.ramp is None:
            return self.amplitude * wave
        u = jnp.clip(t / self.ramp, 0.0, 1.0)
        return self.amplitude * (wave * u * u * (3 - 2 * u))


def _catmull_rom(t: jax.Array, time: jax.Array, values: jax.Array) -> jax.Array:
    """Cubic Hermite interpolation with finite-difference slopes; the end values are held outside the table."""
    t = jnp.clip(t, time[0], time[-1])
    slopes = jnp.gradient(values, axis=0) / jnp.gradient(time)[:, None]
    i = jnp.clip(jnp.searchsorted(time, t, side="right") - 1, 0, time.shape[0] - 2)
    width = time[i + 1] - time[i]
    s = (t - time[i]) / width
    return (
        (1 + 2 * s) * (1 - s) ** 2 * values[i]
        + s * (1 - s) ** 2 * width * slopes[i]
        + s * s * (3 - 2 * s) * values[i + 1]
        + s * s * (s - 1) * width * slopes[i + 1]
    )
