"""The effect of unstretched lengths that change in time: winches, active tensioning, hauling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.fields import component
from dropper_jax.base.numerics import as_array
from dropper_jax.base.records import names_of
from dropper_jax.effects.changing_links import ChangingLinks, LengthFunction, LengthTable, Winch, WinchState
from dropper_jax.model import Effect, Kinematics, Line, Model, ModelView
from dropper_jax.scene import SceneData
from dropper_jax.scene.length_in_time import LengthInTimeSpec, WinchSpec


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
            initial = _scene_length(line, entry)
            changes = np.isin(np.arange(line.links), entry.links)
            found = jnp.where(changes, line.length * (entry.total_length(t, initial) / initial), found)
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
        return tuple(entry.initial_state(_scene_length(model.line, entry)) for entry in self.entries)

    def entered(self, state: tuple[WinchState | None, ...]) -> ControlledLength:
        pairs = zip(self.entries, state, strict=True)
        return replace(self, entries=tuple(entry.with_state(now) for entry, now in pairs))

    def advance(self, before: Kinematics, after: Kinematics, tension: Array, h: Array) -> tuple[WinchState | None, ...]:
        return tuple(entry.advance(after.t, tension, h) for entry in self.entries)


def _scene_length(line: Line, entry: ChangingLinks) -> Array:
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
                entries.append(_make_table(line.name, spec, links))
            else:
                kind = ControlledLength
                measured = links[0] if spec.end == "from" else links[-1]
                entries.append(_make_winch(spec.control, links, measured))
        start += line.links
    if not entries:
        return []
    return [kind(tuple(entries))]


def _make_winch(control: WinchSpec, links: tuple[int, ...], measured: int) -> Winch:
    """The winch of these links, which measures the tension of one of them."""
    return Winch(
        target=as_array(control.target),
        gain=as_array(control.gain),
        limits=as_array(control.limits),
        lengths=as_array(control.lengths),
        links=links,
        measured=measured,
    )


#: Samples between two rows of a table, whose quintics have few turning points there.
SAMPLES_PER_ROW = 20


def _make_table(name: str, spec: LengthInTimeSpec, links: tuple[int, ...]) -> LengthTable:
    """The table of an entry of a line.

    Raises:
        SceneError: a smooth table whose quintics pass zero between its rows.
    """
    table = LengthTable(as_array(spec.time), as_array(spec.length), spec.between == "smooth", links)
    if not table.smooth:
        return table
    last = len(table.time) - 1
    t = np.interp(np.linspace(0.0, last, SAMPLES_PER_ROW * last + 1), np.arange(last + 1), table.time)
    found = np.asarray(jax.vmap(lambda at: table.total_length(at, at))(jnp.asarray(t)))
    lowest = np.argmin(found)
    if found[lowest] <= 0.0:
        raise SceneError(
            f"line {name!r}: length_in_time falls to {found[lowest]:.4g} m at {t[lowest]:.4g} s, between the rows; "
            "allowed: > 0 m. Use between = 'linear', or more rows"
        )
    return table


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
        SceneError: an unknown line, links that it does not have, rigid links, or links that change already.
    """
    chosen = _links_at_end(model, line, end, links)
    entry = LengthFunction(jax.tree.map(jnp.asarray, parameters), function, chosen)
    effect = next((e for e in model.effects if isinstance(e, LengthInTime)), LengthInTime())
    for other in effect.entries:
        if not set(chosen).isdisjoint(other.links):
            raise SceneError(f"links: {links} at {end!r} have another length in time; allowed: one for each link")
    others = [e for e in model.effects if e is not effect]
    return replace(model, effects=(*others, replace(effect, entries=(*effect.entries, entry))))


def _links_at_end(model: Model, line: str | None, end: str, links: int) -> tuple[int, ...]:
    """Numbers of the links nearest the end of a line, the first line if None."""
    names = names_of(model.geometry.members)
    if line is None:
        line = names[0]
    if line not in names:
        raise SceneError(f"line: {line!r} is not a line; {nearest(line, names)}")
    span = model.geometry.spans[names.index(line)]
    count = span.stop - span.start
    if end not in ("from", "to") or not 1 <= links <= count:
        raise SceneError(f"links: {links} at {end!r}; allowed: 1 to {count} at 'from' or 'to' of line {line!r}")
    chosen = range(span.stop - links, span.stop)
    if end == "from":
        chosen = range(span.start, span.start + links)
    if model.line.axial.rigid(model.line.links)[list(chosen)].any():
        raise SceneError(f"line: the links of {line!r} are rigid. Use a line that stretches, such as a rope")
    return tuple(chosen)
