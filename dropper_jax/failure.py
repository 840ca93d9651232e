"""Lines that break: `[[failure]]` of a scene, its arrays, and the step that ends with a link parting.

An entry watches the links of one line, or one of them. At the end of the first step in which the tension of a watched
link reaches its load, or that reaches the time, one link parts: the one named, else the one closest to or farthest
beyond its load. From then on it carries no tension; its mass and water forces stay with its two nodes. An entry breaks
once. Statics know no failure. Which link parts and when has no derivative: gradients are those of the run with its
breaks where they fell.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.errors import SceneError, nearest
from dropper_jax.fields import component, option, parameter
from dropper_jax.schema import read_fields, refuse

if TYPE_CHECKING:
    from dropper_jax.model import Model, State
    from dropper_jax.scene import Scene
    from dropper_jax.sections import LineSpec

#: Relative rounding of a time that is a whole number of steps.
ROUNDING = 1e-9


@dataclasses.dataclass(frozen=True)
class FailureSpec:
    """`[[failure]]`: where, and at which load or time, a line breaks."""

    line: str = option("name of the line", type=str)
    link: int | None = dataclasses.field(
        metadata={"kind": "option", "meaning": "link that breaks, from 1", "type": int, "low": 1}, default=None
    )
    load: float | None = parameter(
        "tension at which it breaks; the line's breaking load by default",
        unit="N",
        low=0.0,
        open_low=True,
        optional=True,
    )
    time: float | None = parameter("time at which it breaks", unit="s", low=0.0, open_low=True, optional=True)

    @classmethod
    def read(cls, table: Any, path: str, lines: tuple[LineSpec, ...]) -> FailureSpec:
        """A checked entry.

        Raises:
            SceneError: an unknown line, a link that it has not, a line that does not stretch, a time without a link, or
                neither load nor time where the line has no breaking load.
        """
        spec = cls(**read_fields(cls, table, path, {}))
        names = [line.name for line in lines]
        pieces = [line.name for line in lines if line.piece_of == spec.line]
        if pieces and spec.line not in names:
            raise SceneError(
                f"{path}.line: {spec.line!r} is cut by its attached points; allowed: one of its pieces, "
                f"{pieces[0]} to {pieces[-1]}"
            )
        if spec.line not in names:
            raise SceneError(f"{path}.line: {spec.line!r} is not a line; {nearest(spec.line, names)}")
        line = lines[names.index(spec.line)]
        if line.rigid:
            raise SceneError(f"{path}.line: the links of {spec.line!r} are rigid; allowed: a line that stretches")
        if spec.link is not None and spec.link > line.links:
            raise refuse(f"{path}.link", spec.link, f"is not a link of {spec.line!r}", f"1 to {line.links}")
        if spec.time is not None and spec.link is None:
            raise SceneError(f"{path}.link: missing; a failure at a time needs the link that breaks, 1 to {line.links}")
        if spec.load is None and spec.time is None and line.breaking_load is None:
            raise SceneError(f"{path}.load: missing; needed where there is no time and the line has no breaking_load")
        return spec


@component
class Failures:
    """What can break, m entries: loads (m, n) [N], infinite where an entry does not watch; times (m,) [s] or infinite.

    `named` holds the index of the link that an entry names, -1 for the most loaded one.
    """

    load: jax.Array
    time: jax.Array
    named: tuple[int, ...] = option("links that entries name", default=())


@component
class Parted:
    """What has parted so far, by entry (m,): the link's index (-1: none), when [s], and the tension then [N]."""

    link: jax.Array
    t: jax.Array
    tension: jax.Array


def make_failures(scene: Scene) -> Failures | None:
    """The arrays of a scene's `[[failure]]` entries; None without any."""
    if not scene.failures:
        return None
    starts = np.cumsum([0, *(line.links for line in scene.lines)])
    load = np.full((len(scene.failures), starts[-1]), np.inf)
    named = []
    for row, spec in zip(load, scene.failures, strict=True):
        i = next(i for i, line in enumerate(scene.lines) if line.name == spec.line)
        line = scene.lines[i]
        own = line.breaking_load if spec.load is None and spec.time is None else spec.load
        if own is not None:
            row[starts[i] : starts[i + 1]] = own
        named.append(-1 if spec.link is None else int(starts[i]) + spec.link - 1)
        if named[-1] >= 0:
            row[np.arange(len(row)) != named[-1]] = np.inf
    times = np.array([np.inf if spec.time is None else spec.time for spec in scene.failures])
    return Failures(load, times, tuple(named))


def nothing_parted(model: Model) -> Parted | None:
    """The start of a run; None for a model in which nothing can break."""
    failures = model.line.failures
    if failures is None:
        return None
    entries = len(failures.named)
    zero = jnp.zeros(entries, model.dtype)
    return Parted(jnp.full(entries, -1, jnp.int32), zero, zero)


def as_parted(model: Model, parted: Parted | None) -> Model:
    """The model whose parted links carry nothing."""
    if parted is None:
        return model
    line = model.line
    gone = jnp.any(parted.link[:, None] == jnp.arange(line.links), axis=0)
    axial = dataclasses.replace(line.axial, intact=1.0 - gone.astype(model.dtype))
    return dataclasses.replace(model, lines=(dataclasses.replace(line, axial=axial),))


def step_and_part(advance: Callable[[Model, State], tuple[State, Any]], model: Model, s: State) -> tuple[State, Any]:
    """One step by `advance` with what has parted, and what parts at its end.

    The energy of stretch and bending that a link holds as it parts is lost; it is the last entry of `State.work`.
    """
    tracked = s.work.size > 0
    before = as_parted(model, s.parted)
    s1, report = advance(before, dataclasses.replace(s, parted=None, work=s.work[:-1] if tracked else s.work))
    parted = _part(model, s.parted, s1)
    if not tracked:
        return dataclasses.replace(s1, parted=parted), report
    lost = _held(as_parted(model, parted), s1) - _held(before, s1)
    work = jnp.concatenate([s1.work, s.work[-1:] + lost])
    return dataclasses.replace(s1, parted=parted, work=work), report


def _held(model: Model, s: State) -> jax.Array:
    """Energy [J] that links hold until they part: of their stretch and, where lines resist it, of their bending."""
    k = model.kinematics(s.r, s.v, s.t)
    own = model.line.axial.energy(k.links, model.line.length)
    return sum((e.potential(k) for e in model.effects if e.parts), own)


def _part(model: Model, parted: Parted, s1: State) -> Parted:
    failures = model.line.failures
    tension, t = jax.lax.stop_gradient((s1.tension, s1.t))
    share = tension / failures.load
    named = jnp.asarray(failures.named, jnp.int32)
    link = jnp.where(named >= 0, named, jnp.argmax(share, axis=1))
    due = (jnp.max(share, axis=1) >= 1.0) | (t >= failures.time * (1.0 - ROUNDING))
    now = due & (parted.link < 0)
    return Parted(
        jnp.where(now, link, parted.link).astype(jnp.int32),
        jnp.where(now, t, parted.t),
        jnp.where(now, tension[link], parted.tension),
    )


def breaks(scene: Scene, parted: Parted | None) -> tuple[dict[str, Any], ...]:
    """What broke in a run, by time: line, link (from 1), time [s] and tension [N]."""
    if parted is None:
        return ()
    starts = np.cumsum([0, *(line.links for line in scene.lines)])
    found = []
    for link, t, tension in zip(
        *(np.asarray(x).tolist() for x in (parted.link, parted.t, parted.tension)), strict=True
    ):
        if link < 0:
            continue
        i = int(np.searchsorted(starts, link, side="right")) - 1
        row = {"line": scene.lines[i].name, "link": link - int(starts[i]) + 1, "time_s": t, "tension_n": tension}
        found.append(row)
    return tuple(sorted(found, key=lambda row: row["time_s"]))


def words(row: Mapping[str, Any]) -> str:
    """One line about a break."""
    return (
        f"line {row['line']!r} broke at its link {row['link']} at t = {row['time_s']:.6g} s "
        f"under {row['tension_n']:.6g} N"
    )
