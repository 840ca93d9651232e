"""Slow changes of the water over time: a table, linear between its times, or harmonic constituents."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, parameter


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
