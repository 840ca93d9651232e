"""Scalar quantities of a motion, by name (`tension.3.max`, `angle.1.std`): differentiable functions of saved states."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.numerics import safe_norm
from dropper_jax.model import Model, state
from dropper_jax.statics.modes import natural_periods
from dropper_jax.stepping.integrate import Trajectory
from dropper_jax.stepping.observe import observe

#: Slope of the S-N curve in `fatigue`; 3 is usual for ropes and chains (DNV-OS-E301).
SLOPE = 3.0

#: Signals in time: unit, whether they are counted by link or by node, meaning.
SIGNALS = {
    "tension": ("N", "link", "tension of a link; without a number, of all links"),
    "angle": ("rad", "link", "angle of a link from the horizontal, positive downwards, -pi/2 to pi/2"),
    "excursion": ("m", "node", "distance of a free node from its start position; without a number the maximum"),
    "x": ("m", "node", "position of a free node"),
    "y": ("m", "node", "position of a free node"),
    "z": ("m", "node", "position of a free node"),
    "period": ("s", "mode", "natural period about the static pose, the longest first; of the start alone"),
    "energy": ("J", None, "kinetic and potential energy"),
}


def _root(x: jax.Array, power: float = 0.5) -> jax.Array:
    """`x**power`, with derivative 0 at 0."""
    return jnp.where(x > 0, jnp.where(x > 0, x, 1.0) ** power, 0.0)


def _fatigue(x: jax.Array) -> jax.Array:
    size = jnp.abs(x - jnp.mean(x, axis=0))
    return _root(jnp.mean(size**SLOPE), 1 / SLOPE)


def _peak(x: jax.Array) -> jax.Array:
    weight = 1 - jnp.cos(2 * jnp.pi * jnp.arange(len(x)) / len(x))
    lines = jnp.fft.rfft((x - jnp.mean(x, axis=0)) * weight[:, None], axis=0)
    return 2 * _root(jnp.max(lines.real**2 + lines.imag**2)) / jnp.sum(weight)


def _highest(x: jax.Array) -> jax.Array:
    """The maximum value (times, members): the vertex of the parabola through it and its two neighbours in time.

    The derivative of the largest sample alone is that at a fixed time. Away from the maximum it has an error from the
    slope there, of first order in the step, and of several hundred per cent for short peaks.
    """
    # the member with the highest value, and its time
    member = jnp.argmax(jnp.max(x, axis=0))
    x = x[:, member]
    k = jnp.argmax(x)
    inside = (k > 0) & (k < len(x) - 1)
    near = jnp.clip(k, 1, max(len(x) - 2, 1))
    before, top, after = (x[jnp.clip(near + i, 0, len(x) - 1)] for i in (-1, 0, 1))
    bend = 2.0 * top - before - after
    rise = jnp.where(bend > 0, (after - before) ** 2 / (8.0 * jnp.where(bend > 0, bend, 1.0)), 0.0)
    return jnp.where(inside, top + rise, x[k])


def _std(x: jax.Array) -> jax.Array:
    return _root(jnp.mean((x - jnp.mean(x, axis=0)) ** 2))


#: The statistic of the start alone: for a static start only statics is computed, without a run.
START = "start"
#: The signal that exists only for a start.
PERIOD = "period"

#: Statistics of a signal (times, members). `max` and `min` are vertices of parabolas through three samples; `start`
#: refers to the state at t = 0; `fatigue` is `(mean |x - mean x|^3)^(1/3)`, the amplitude of equal damage at an equal
#: rate of cycles; `peak` is the height of the highest line of the amplitude spectrum (Hann window).
STATISTICS: dict[str, Callable[[jax.Array], jax.Array]] = {
    "max": _highest,
    "min": lambda x: -_highest(-x),
    "mean": jnp.mean,
    "final": lambda x: jnp.mean(x[-1]),
    START: lambda x: jnp.mean(x[0]),
    "std": _std,
    "fatigue": _fatigue,
    "peak": _peak,
}


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A named number of a motion.

    Attributes:
        name: `SIGNAL[.NUMBER].STATISTIC`.
        signal, number, statistic: its parts; links and nodes are counted from 1.
        unit: as printed.
    """

    name: str
    signal: str
    number: int | None
    statistic: str

    @property
    def unit(self) -> str:
        return SIGNALS[self.signal][0]

    @property
    def at_rest(self) -> bool:
        """Whether it depends on the start alone."""
        return self.statistic == START

    def __call__(self, model: Model, start: jax.Array, run: Trajectory, t: jax.Array) -> jax.Array:
        """The number for saved states at times t (k,) [s] of a run from the free nodes `start` (nodes, 3)."""
        if self.signal == PERIOD:
            pose = state(model, start, tension=run.tension[0], t=t[0])
            return natural_periods(model, pose, self.number)[-1]
        values = _signal(self.signal, model, start, run, t)
        if self.number is not None:
            values = values[:, self.number - 1 : self.number]
        return STATISTICS[self.statistic](values)


def _signal(name: str, model: Model, start: jax.Array, run: Trajectory, t: jax.Array) -> jax.Array:
    if name == "tension":
        return run.tension
    if name in "xyz":
        return run.r[:, :, "xyz".index(name)]
    if name == "excursion":
        return safe_norm(run.r - start)
    if name == "energy":
        seen = jax.vmap(lambda *now: observe(model, *now))(run.r, run.v, t, run.parted)
        return (seen.kinetic + seen.potential)[:, None]
    links = jax.vmap(lambda r, t: model.links(r, model.ends(t)))(run.r, t)
    across = safe_norm(links * jnp.array([1.0, 1.0, 0.0], links.dtype))
    return jnp.arctan2(-links[:, :, 2], across)


def quantity(name: str, model: Model) -> Quantity:
    """The quantity of a name such as `tension.3.max`, `excursion.max`, `angle.1.std`, `energy.final`.

    Raises:
        SceneError: an unknown signal or statistic, or a link or node that does not exist.
    """
    signal, *middle, statistic = name.split(".") if "." in name else (name, "")
    for what, word, known in (("signal", signal, SIGNALS), ("statistic", statistic, STATISTICS)):
        if word not in known:
            raise SceneError(
                f"of: {name!r}: {word!r} is not a {what}; {nearest(word, known)}; allowed: SIGNAL[.NUMBER].STATISTIC"
            )
    if signal == PERIOD and statistic != START:
        raise SceneError(f"of: {name!r}: a natural period belongs to the static pose; allowed: period.1.start")
    counted = SIGNALS[signal][1]
    if not middle:
        if signal in ("angle", "x", "y", "z", PERIOD):
            raise SceneError(f"of: {name!r} has no {counted}; allowed: such as {signal}.1.{statistic}")
        return Quantity(name, signal, None, statistic)
    most = {"link": model.line.links, "node": model.free_nodes, "mode": 3 * model.free_nodes, None: 0}[counted]
    if len(middle) > 1 or not middle[0].isdecimal() or not 1 <= int(middle[0]) <= most:
        raise SceneError(f"of: {name!r}: {'.'.join(middle)!r} is not a {counted or 'part'}; allowed: 1 to {most}")
    return Quantity(name, signal, int(middle[0]), statistic)
