"""Unstretched lengths of links that change in time: winches, active tensioning, hauling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import as_array
from dropper_jax.base.records import names_of
from dropper_jax.effects.end_motion import interpolate_quintic
from dropper_jax.model import Effect, Kinematics, Line, Model, ModelView
from dropper_jax.scene import SceneData


class ChangingLinks:
    """Links whose total length changes in time: by a table, a function or a winch. Winches have a state, which a run
    carries."""

    @property
    def links(self) -> tuple[int, ...]:
        """The links, from 0, among those of all lines."""
        raise NotImplementedError

    @property
    def corners(self) -> Array | None:
        """Times (k,) [s] at which the length is not smooth; None: never."""
        return None

    def total(self, t: Array, initial: Array) -> Array:
        """Total length [m] of the links at time t [s]; `initial` is that in the scene."""
        raise NotImplementedError

    def begin(self, initial: Array) -> WinchState | None:
        """The state at the start of a run."""
        return None

    def entered(self, now: WinchState | None) -> ChangingLinks:
        """The same links in this state."""
        return self

    def advance(self, t: Array, tension: Array, h: Array) -> WinchState | None:
        """The state after a step of h [s] that ended at t [s] with these tensions (n,) [N]."""
        return None


@component
class LengthTable(ChangingLinks):
    """Total length of some links over time; before and after the table it is constant."""

    time: Array = parameter("times of the rows", unit="s", shape="table")
    length: Array = parameter("total length at those times", unit="m", shape="table")
    smooth: bool = option("quintics between the rows (as `end_motion`), not straight lines", default=False)
    links: tuple[int, ...] = option("links, from 0, among those of all lines", default=())

    def total(self, t: Array, initial: Array) -> Array:
        if self.smooth:
            return interpolate_quintic(t, self.time, self.length[:, None])[0]
        return jnp.interp(t, self.time, self.length)

    @property
    def corners(self) -> Array | None:
        return self.time


@component
class LengthFunction(ChangingLinks):
    """Total length of some links as a JAX function of time and of parameters."""

    parameters: Any
    function: Callable[[Array, Any], Array] = option("length [m] of (time [s], parameters)")
    links: tuple[int, ...] = option("links, from 0, among those of all lines", default=())

    def total(self, t: Array, initial: Array) -> Array:
        return jnp.asarray(self.function(t, self.parameters), t.dtype)


@component
class WinchState:
    """Time [s] at which a winch was last set, total length [m] then, rate since [m/s], integral of the error [N s]."""

    t: Array
    length: Array
    rate: Array
    integral: Array


@component
class Winch(ChangingLinks):
    """A proportional-integral winch on the tension T of the end link, set once per step:

        dL/dt = k_p (T - T*) + k_i int (T - T*) dt,    within the limits of rate and length

    The integral stops while the rate or the length is at a limit. First order in the step.
    """

    target: Array = parameter("tension T*", unit="N", low=0.0)
    gain: Array = parameter("k_p [m/s/N] and k_i [m/s^2/N]", unit="-", shape="table", low=0.0)
    limits: Array = parameter("lowest and highest rate", unit="m/s", shape="table")
    lengths: Array = parameter("shortest and longest total length", unit="m", shape="table", low=0.0)
    now: WinchState | None = None
    links: tuple[int, ...] = option("links, from 0, among those of all lines", default=())
    measured: int = option("link whose tension is measured", default=0)

    def total(self, t: Array, initial: Array) -> Array:
        if self.now is None:
            return initial
        return jnp.clip(self.now.length + self.now.rate * (t - self.now.t), *self.lengths)

    def begin(self, initial: Array) -> WinchState:
        zero = jnp.zeros_like(initial)
        return WinchState(zero, initial, zero, zero)

    def entered(self, now: WinchState | None) -> Winch:
        return replace(self, now=now)

    def advance(self, t: Array, tension: Array, h: Array) -> WinchState | None:
        now = self.now
        if now is None:
            return None
        error = tension[self.measured] - self.target
        integral = now.integral + h * error
        wanted = self.gain[0] * error + self.gain[1] * integral
        length = self.total(t, now.length)
        rate = jnp.clip(wanted, *self.limits)
        shortest, longest = self.lengths
        at_end = ((length <= shortest) & (rate < 0.0)) | ((length >= longest) & (rate > 0.0))
        rate = jnp.where(at_end, 0.0, rate)
        integral = jnp.where(rate == wanted, integral, now.integral)
        return WinchState(t, length, rate, integral)


@component
class LengthInTime(Effect):
    """Unstretched lengths of links that change in time, shared among the links of an entry as in the scene.

    Tensions, internal damping and energies follow the lengths of the instant; the work of the drums is recorded as
    `length_in_time`. Masses, weights and water forces of the links do not change.
    """

    name = "length_in_time"
    entries: tuple[ChangingLinks, ...] = ()

    def unstretched_lengths(self, line: Line, t: Array) -> Array:
        """Unstretched lengths of all links at time t [s], (n,) [m]."""
        found = line.length
        for entry in self.entries:
            initial = _total(line, entry)
            changes = np.isin(np.arange(line.links), entry.links)
            found = jnp.where(changes, line.length * (entry.total(t, initial) / initial), found)
        return found

    @property
    def corners(self) -> Array | None:
        times = [entry.corners for entry in self.entries if entry.corners is not None]
        if times:
            return jnp.concatenate(times)
        return None


@component
class ControlledLength(LengthInTime):
    """The same with winches, whose states a run carries."""

    def begin(self, model: ModelView) -> tuple[WinchState | None, ...]:
        return tuple(entry.begin(_total(model.line, entry)) for entry in self.entries)

    def entered(self, state: tuple[WinchState | None, ...]) -> ControlledLength:
        pairs = zip(self.entries, state, strict=True)
        return replace(self, entries=tuple(entry.entered(now) for entry, now in pairs))

    def advance(self, before: Kinematics, after: Kinematics, tension: Array, h: Array) -> tuple[WinchState | None, ...]:
        return tuple(entry.advance(after.t, tension, h) for entry in self.entries)


def _total(line: Line, entry: ChangingLinks) -> Array:
    """Total length [m] of the links of an entry in the scene."""
    return jnp.sum(line.length[np.array(entry.links)])


def changing_lengths(scene: SceneData) -> list[Effect]:
    """The effect of all `[[line.length_in_time]]` of a scene, in a list that is empty without any."""
    entries: list[ChangingLinks] = []
    kind = LengthInTime
    start = 0
    for line in scene.lines:
        for spec in line.length_in_time:
            links = tuple(start + i for i in spec.numbers(line.links))
            if spec.control is None:
                table = LengthTable(as_array(spec.time), as_array(spec.length), spec.between == "smooth", links)
                _check_between_rows(line.name, table)
                entries.append(table)
            else:
                kind = ControlledLength
                control = spec.control
                given = (control.target, control.gain, control.limits, control.lengths)
                target, gain, limits, lengths = map(as_array, given)
                measured = links[0 if spec.end == "from" else -1]
                entries.append(Winch(target, gain, limits, lengths, links=links, measured=measured))
        start += line.links
    if not entries:
        return []
    return [kind(tuple(entries))]


#: Samples between two rows of a table, whose quintics have few turning points there.
SAMPLES_PER_ROW = 20


def _check_between_rows(name: str, table: LengthTable) -> None:
    """Reject a smooth table whose quintics pass zero between its rows."""
    if not table.smooth:
        return
    last = len(table.time) - 1
    t = np.interp(np.linspace(0.0, last, SAMPLES_PER_ROW * last + 1), np.arange(last + 1), table.time)
    found = np.asarray(jax.vmap(lambda at: table.total(at, at))(jnp.asarray(t)))
    lowest = np.argmin(found)
    if found[lowest] <= 0.0:
        raise SceneError(
            f"line {name!r}: length_in_time falls to {found[lowest]:.4g} m at {t[lowest]:.4g} s, between the rows; "
            "allowed: > 0 m. Use between = 'linear', or more rows"
        )


def with_length_in_time(
    model: Model,
    function: Callable[[Array, Any], Array],
    parameters: Any = (),
    line: str | None = None,
    end: str = "to",
    links: int = 1,
) -> Model:
    """The model with links at an end of a line whose total unstretched length [m] is a JAX function of time.

    Derivatives by the `parameters` are those by `model.effect("length_in_time").entries[i].parameters`. A state for the
    model is `dj.state(model, r, v)` or `dj.initial_state(model, scene.start)`: its ledger of work has an entry more.

    Args:
        function: length [m] of (time [s], parameters), by functions of `jax.numpy`, positive; at t = 0 that of the
            links. Static: a new function is compiled again, other parameters are not.
        parameters: arrays, or a tree of them.
        line: name of the line; the first one if omitted.
        end: `from` or `to`.
        links: number of links nearest that end.

    Raises:
        SceneError: an unknown line, links that it does not have, or rigid links.
    """
    members = model.geometry.members
    names = names_of(members)
    line = names[0] if line is None else line
    if line not in names:
        raise SceneError(f"line: {line!r} is not a line; {nearest(line, names)}")
    span = model.geometry.spans[names.index(line)]
    count = span.stop - span.start
    if end not in ("from", "to") or not 1 <= links <= count:
        raise SceneError(f"links: {links} at {end!r}; allowed: 1 to {count} at 'from' or 'to' of line {line!r}")
    first = span.start if end == "from" else span.stop - links
    chosen = tuple(range(first, first + links))
    if model.line.axial.rigid(model.line.links)[list(chosen)].any():
        raise SceneError(f"line: the links of {line!r} are rigid. Use a line that stretches, such as a rope")
    entry = LengthFunction(jax.tree.map(jnp.asarray, parameters), function, chosen)
    effects = list(model.effects)
    for i, effect in enumerate(effects):
        if isinstance(effect, LengthInTime):
            effects[i] = replace(effect, entries=(*effect.entries, entry))
            return replace(model, effects=tuple(effects))
    return replace(model, effects=(*effects, LengthInTime((entry,))))
