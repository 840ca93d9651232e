"""Prescribed motion of an end: harmonic or from a table."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import trace_once
from dropper_jax.base.read import Values, rises
from dropper_jax.model import HeldMotion
from dropper_jax.scene import SceneData

#: Error of a motion that is neither harmonic nor tabulated.
NEEDS_ONE_MOTION = "effects.end_motion: give either `amplitude` and `period`, or `time` and `displacement`"


@component
class EndMotion(HeldMotion):
    """Displacement of a prescribed point, and of others that move with it (such as a vessel's), from their positions.

    Harmonic: `x(t) = s(t) a sin(2 pi t / period + phase)`, with `s(t) = u^3 (10 - 15 u + 6 u^2)`, `u = min(t/ramp, 1)`
    if a ramp is given; a lower-order ramp would start and end with a jump of velocity or acceleration. For a table, the
    ramp from its first time applies to the displacement from the first row: `x = d0 + s (d - d0)`.

    Tabulated: `displacement` (k, 3) at `time`. Quintics between the rows have the slopes and curvatures of a parabola
    through three rows, so that velocity and acceleration are continuous. Before and after the table the point rests. A
    table whose first two and last two rows are equal starts and ends without a jump.
    """

    name = "end_motion"
    amplitude: Array | None = parameter("amplitude per axis", unit="m", shape="vector", default=None)
    period: Array | None = parameter("period", unit="s", above=0.0, default=None)
    phase: Array | None = parameter("phase", unit="rad", default=None)
    ramp: Array | None = parameter("time to reach the full motion", unit="s", above=0.0, default=None)
    time: Array | None = parameter("times of the table", unit="s", shape="table", default=None)
    displacement: Array | None = parameter("displacement at those times", unit="m", shape="vectors", default=None)
    point: str = option("name of the point that moves", type=str, default="")
    also: tuple[str, ...] = option("further points that move with it", type=list, default=())

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        cls.check_points(values, scene)
        given = {key for key, value in values.items() if value is not None}
        is_table = given >= {"time", "displacement"} and not given & {"amplitude", "period", "phase"}
        is_harmonic = given >= {"amplitude", "period"} and not given & {"time", "displacement"}
        if not (is_table or is_harmonic):
            raise SceneError(NEEDS_ONE_MOTION)
        if is_table and (len(values["time"]) != len(values["displacement"]) or not rises(values["time"], 2)):
            raise SceneError("effects.end_motion.time: needs at least 2 increasing times, one per displacement")

    def displace(self, t: Array) -> Array:
        """Displacement (3,) [m] at time t [s]."""
        if self.time is not None and self.displacement is not None:
            row = interpolate_quintic(t, self.time, self.displacement)
            if self.ramp is None:
                return row
            return apply_ramp((t - self.time[0]) / self.ramp, row, self.displacement[0])
        if self.amplitude is None or self.period is None:
            raise SceneError(NEEDS_ONE_MOTION)
        phase = 0.0 if self.phase is None else self.phase
        motion = self.amplitude * jnp.sin(2 * jnp.pi * t / self.period + phase)
        if self.ramp is None:
            return motion
        return apply_ramp(t / self.ramp, motion, jnp.zeros_like(motion))

    @property
    def _begin(self) -> Array:
        """Time [s] from which the point moves."""
        if self.time is not None:
            return self.time[0]
        return jnp.zeros_like(jnp.asarray(self.period))

    @property
    def kinks(self) -> Array | None:
        found = []
        if self.ramp is None:
            found.append(self._begin)
        if self.time is not None:
            found.append(self.time[-1])
        return jnp.stack(found) if found else None

    @property
    def corners(self) -> Array | None:
        """All rows of a table, at which the third derivative jumps, and both ends of a ramp."""
        begin = self._begin
        if self.ramp is None:
            ramp = jnp.ravel(begin)
        else:
            ramp = jnp.stack([begin, begin + self.ramp])
        if self.time is None:
            return ramp
        return jnp.concatenate([self.time, ramp])


def apply_ramp(u: Array, full: Array, first: Array) -> Array:
    """From the first displacement (3,) [m] at u = 0 to the full one at 1 and later."""
    u = jnp.clip(u, 0.0, 1.0)
    return first + (full - first) * (u**3 * (10 - 15 * u + 6 * u * u))


@trace_once
def interpolate_quintic(t: Array, time: Array, values: Array) -> Array:
    """Quintic Hermite interpolation of rows (k, 3), twice differentiable; the end values are held outside the table."""
    t = jnp.clip(t, time[0], time[-1])
    slopes, bends = _derivatives(time, values)
    i = jnp.clip(jnp.searchsorted(time, t, side="right") - 1, 0, time.shape[0] - 2)
    after = i + 1
    width = time[after] - time[i]
    s = (t - time[i]) / width
    q = 1 - s
    left = quintic_of_end(s, q, width, values[i], slopes[i], bends[i])
    return left + quintic_of_end(q, s, -width, values[after], slopes[after], bends[after])


def quintic_of_end(s: Array, q: Array, width: Array, value: Array, slope: Array, bend: Array) -> Array:
    """Part of a quintic Hermite interpolation due to one end of an interval, s from it and q = 1 - s from the other.

    The width of the interval is negative at its last end.
    """
    fall = q**3
    moved = fall * (1 + 3 * s + 6 * s * s) * value + width * (fall * s * (1 + 3 * s)) * slope
    return moved + width**2 * (0.5 * fall * s * s) * bend


def _derivatives(time: Array, values: Array) -> tuple[Array, Array]:
    """Slopes and curvatures (k, 3) of parabolas through each row and its neighbours; zero curvature at both ends."""
    width = jnp.diff(time)[:, None]
    chord = jnp.diff(values, axis=0) / width
    bend = 2 * (chord[1:] - chord[:-1]) / (width[1:] + width[:-1])
    slope = chord[:-1] + 0.5 * width[:-1] * bend
    straight = jnp.zeros_like(values[:1])
    return jnp.concatenate([chord[:1], slope, chord[-1:]]), jnp.concatenate([straight, bend, straight])
