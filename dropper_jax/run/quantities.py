"""Scalar quantities of a motion by name: `SIGNAL[.WHERE].STATISTIC`, such as `tension.west-leg.fairlead.max`.

They are differentiable functions of saved states. One table serves all commands: `sensitivity --of`, `sweep
--quantities`, `design --target`, `cases --of` and the constraints of `optimise`. WHERE is one of

- a number from 1, of a link, a free node or a mode: `tension.3.max`;
- a line, also with one of its ends: `first`, `last`, `anchor` (at its only fixed point), `fairlead` (the other one), or
  the name of a point on it: `tension.west-leg.fairlead.max`;
- a point: `offset.buoy.max`, `z.buoy.mean`;
- a fixed point and a direction, `horizontal`, `vertical` (upwards), `total` or `uplift`, the angle of the force above
  the horizontal: `anchor.west.horizontal.max`;
- of `line`, an end of a line and `tension` or `angle`, that of the line above the horizontal as it leaves this end:
  `line.west-leg.fairlead.angle.min`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.fields import component, option
from dropper_jax.base.numerics import horizontal_norm, safe_norm
from dropper_jax.model import Model, Parted, State, state
from dropper_jax.model.geometry import Member
from dropper_jax.model.slots import LengthOverTime, Stateful
from dropper_jax.run.end_links import load_on_fixed_point
from dropper_jax.run.statistics import NAMES, OVER_STEPS, PERIOD, START, statistic
from dropper_jax.statics.modes import natural_periods
from dropper_jax.stepping.extremes import Extremes
from dropper_jax.stepping.integrate import Trajectory, observe

#: Signals in time: unit, what WHERE names, meaning.
SIGNALS = {
    "tension": ("N", "link", "tension of a link; of a line or of all links the highest"),
    "anchor": ("N", "anchor", "force of the lines on a fixed point"),
    "angle": ("rad", "link", "angle of a link from the horizontal, positive downwards, -pi/2 to pi/2"),
    "line": ("N", "end", "tension [N] or angle [rad] of a line at an end, upwards positive"),
    "curvature": ("1/m", "line", "change of direction per length between two links, the highest of a line"),
    "offset": ("m", "node", "horizontal distance of a point from its position in the scene"),
    "excursion": ("m", "node", "distance of a free node from its start position; without a number the maximum"),
    "depth": ("m", "node", "depth of a point below z = 0"),
    "x": ("m", "node", "position of a node"),
    "y": ("m", "node", "position of a node"),
    "z": ("m", "node", "position of a node"),
    "period": ("s", "mode", "natural period about the static pose, the longest first; of the start alone"),
    "energy": ("J", None, "kinetic and potential energy"),
}
#: Signals of all links or nodes at once.
OF_ALL = ("tension", "excursion", "energy")
DIRECTIONS = ("horizontal", "vertical", "total", "uplift")


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A named number of a motion.

    Attributes:
        name: `SIGNAL[.WHERE].STATISTIC`.
        signal, statistic: its first and last part.
        members: links, modes, or nodes that it refers to, from 0; None for all. Nodes are free ones, then those of
            `Model.nodes`. Of an anchor these are its links.
        signs: of an anchor, 1 for links that start there, -1 for links that end there; of an angle, those of links.
        direction: of an anchor.
        point: number of the point, of an offset.
    """

    name: str
    signal: str
    statistic: str
    members: tuple[int, ...] | None = None
    signs: tuple[float, ...] = ()
    direction: str = ""
    point: int = 0

    @property
    def unit(self) -> str:
        if self.direction == "uplift":
            return "rad"
        return SIGNALS[self.signal][0]

    @property
    def modes(self) -> int:
        """Of a period, the number of modes up to its own."""
        return max(self.members or (0,)) + 1

    @property
    def at_rest(self) -> bool:
        """Whether it depends on the start alone."""
        return self.statistic == START

    def __call__(self, model: Model, start: jax.Array, run: Trajectory, t: jax.Array) -> jax.Array:
        """The number for saved states at times t (k,) [s] of a run from the free nodes `start` (nodes, 3)."""
        if self.signal == PERIOD:
            pose = state(model, start, tension=run.tension[0], t=t[0])
            return natural_periods(model, pose, self.modes)[-1]
        samples = self.in_time(model, start, run.r, run.v, run.tension, t, run.parted)
        return statistic(self.statistic, samples, t[-1] / len(t) if len(t) < 2 else t[1] - t[0])

    @partial(jax.jit, static_argnums=0, inline=True)
    def in_time(self, model: Model, start: jax.Array, *saved: jax.Array | Parted | None) -> jax.Array:
        """The signal (times, members) of saved instants, given as in `instant`."""
        return jax.vmap(lambda *now: self.instant(model, start, *now))(*saved)

    @partial(jax.jit, static_argnums=0, inline=True)
    def of_pose(self, model: Model, s: State) -> jax.Array:
        """The number at one instant, a static pose."""
        if self.signal == PERIOD:
            return natural_periods(model, s, self.modes)[-1]
        if model.sea is None:
            still = model
        else:
            still = dataclasses.replace(model, sea=model.sea.without_waves())
        return statistic(self.statistic, self.instant(still, s.r, s.r, s.v, s.tension, s.t, s.parted)[None], 1.0)

    def instant(
        self,
        model: Model,
        start: jax.Array,
        r: jax.Array,
        v: jax.Array,
        tension: jax.Array,
        t: jax.Array,
        parted: Parted | None = None,
    ) -> jax.Array:
        """The signal (members,) of one instant: free nodes (nodes, 3) and tensions (n,) at time t [s]."""
        if self.signal == "energy":
            if any(isinstance(effect, Stateful) for effect in model.having(LengthOverTime)):
                raise SceneError(
                    "energy: depends on the lengths that winches have set, which this quantity does not have; "
                    "allowed: in scenes whose line.length_in_time are tables"
                )
            seen = observe(model, r, v, t, parted)
            return (seen.kinetic + seen.potential)[None]
        if self.signal == "anchor":
            return self._anchor_load(model, r, tension, t)[None]
        if self.signal == "tension":
            found = tension
        elif self.signal == "angle":
            links = model.links(r, model.ends(t))
            found = jnp.arctan2(-links[:, 2], horizontal_norm(links))
        elif self.signal == "curvature":
            links = model.links(r, model.ends(t))
            length = model.line.length
            along = links / safe_norm(links)[:, None]
            found = safe_norm(along[1:] - along[:-1]) / (0.5 * (length[1:] + length[:-1]))
        else:
            found = self._of_nodes(model, start, r, t)
        if self.members is not None:
            found = found[np.array(self.members)]
        if self.signs:
            return found * np.array(self.signs)
        return found

    def _of_nodes(self, model: Model, start: jax.Array, r: jax.Array, t: jax.Array) -> jax.Array:
        if self.members is not None and max(self.members) >= len(r):
            r = jnp.concatenate([r, model.nodes(r, model.ends(t))])
            start = jnp.concatenate([start, model.nodes(start, model.ends(t))])
        if self.signal == "excursion":
            return safe_norm(r - start)
        if self.signal == "offset":
            return horizontal_norm(r - model.points[self.point].position)
        if self.signal == "depth":
            return -r[:, 2]
        return r[:, "xyz".index(self.signal)]

    def _anchor_load(self, model: Model, r: jax.Array, tension: jax.Array, t: jax.Array) -> jax.Array:
        """Force of the lines on a fixed point [N], or its angle [rad]."""
        force = load_on_fixed_point(model, self.members or (), self.signs, r, tension, t)
        across = horizontal_norm(force)
        up = force[2]
        if self.direction == "uplift":
            return jnp.arctan2(up, across)
        return {"horizontal": across, "vertical": up, "total": safe_norm(force)}[self.direction]


@component
class QuantitySignals:
    """Signals (n + q,) of a step whose extremes over all steps a run keeps: tensions of the links, and quantities.

    Quantities are maxima and minima; each has the extreme of its members. Without the parabola of `STATISTICS`, a
    maximum is that of the steps. See `stepping.extremes`.
    """

    start: jax.Array
    quantities: tuple[Quantity, ...] = option("maxima and minima")

    def __call__(self, model: Model, before: State, after: State) -> tuple[jax.Array, jax.Array]:
        now = after.r, after.v, after.tension, after.t, after.parted
        found = [OVER_STEPS[one.statistic](one.instant(model, self.start, *now))[None] for one in self.quantities]
        return jnp.concatenate([after.tension, *found]), after.t

    def over_steps(self, extremes: Extremes) -> dict[Quantity, jax.Array]:
        """The extreme of each quantity since the last saved time (k,), from rows (k, n + q)."""
        sides = {"max": extremes.largest, "min": extremes.least}
        first = extremes.least.shape[-1] - len(self.quantities)
        return {one: sides[one.statistic][..., first + i] for i, one in enumerate(self.quantities)}


def quantity_signals(quantities: Sequence[Quantity], start: jax.Array) -> QuantitySignals:
    """The signals of those of the quantities that are maxima and minima, of runs from the free nodes `start`."""
    return QuantitySignals(start, tuple(one for one in quantities if one.statistic in OVER_STEPS))


def quantity(name: str, model: Model, option: str = "of") -> Quantity:
    """The quantity of a name such as `tension.3.max`, `tension.west-leg.fairlead.max`, `offset.buoy.max`.

    Args:
        option: named in messages.

    Raises:
        SceneError: an unknown signal, statistic, line or point, or a link or node that does not exist.
    """
    signal, *middle, wanted = name.split(".") if "." in name else (name, "")
    for what, word, known in (("signal", signal, SIGNALS), ("statistic", wanted, NAMES)):
        if word not in known:
            raise SceneError(
                f"{option}: {name!r}: {word!r} is not a {what}; {nearest(word, known)}; allowed: "
                "SIGNAL[.WHERE].STATISTIC, such as tension.max"
            )
    if signal == PERIOD and wanted != START:
        raise SceneError(f"{option}: {name!r}: a natural period belongs to the static pose; allowed: period.1.start")
    return _Parser(name, model, option).quantity(signal, middle, wanted)


def static_quantity(name: str, model: Model, option: str) -> Quantity:
    """The same for a static pose, which needs no statistic: `tension.chain.first`, `depth.buoy`."""
    last = name.rpartition(".")[2]
    return quantity(name if last in NAMES else f"{name}.{START}", model, option)


class _Parser:
    """Finds what a name refers to in a model."""

    def __init__(self, name: str, model: Model, option: str) -> None:
        self.name, self.model, self.option = name, model, option
        self.points = [point.name for point in model.points]

    def quantity(self, signal: str, where: list[str], statistic: str) -> Quantity:
        counted = SIGNALS[signal][1]
        if not where:
            if signal not in OF_ALL:
                known = {"anchor": "west.horizontal", "node": "buoy", "end": "leg.first.angle", "line": "leg"}
                where_ = known.get(counted, "1")
                raise self._error(f"has no {counted}; allowed: such as {signal}.{where_}.{statistic}")
            return Quantity(self.name, signal, statistic)
        if counted == "anchor":
            return self._anchor(signal, where, statistic)
        if counted == "end":
            signal = where[-1]
            if len(where) != 3 or signal not in ("tension", "angle"):
                raise self._error(f"has no end and signal; allowed: such as line.leg.fairlead.angle.{statistic}")
            links, sign = self._end(*where[:2])
            return Quantity(self.name, signal, statistic, links, (sign,) if signal == "angle" else ())
        if counted == "line":
            last = {span.stop - 1 for _, span in self._members()}
            joints = tuple(i for i in self._links(*where[:1]) if i not in last)
            if len(where) > 1 or not joints:
                raise self._error(f"allowed: a line of two links or more, such as {signal}.leg.{statistic}")
            return Quantity(self.name, signal, statistic, joints)
        if where[0].isdecimal() or counted in ("mode", None):
            return Quantity(self.name, signal, statistic, (self._number(where, counted),))
        if counted == "link":
            return Quantity(self.name, signal, statistic, self._links(*where))
        if len(where) > 1:
            raise self._error(f"{'.'.join(where)!r} is not a point; {nearest(where[0], self.points)}")
        point = self._number_of(where[0], self.points, "point")
        return Quantity(self.name, signal, statistic, (self._node(point),), point=point)

    def _number(self, where: list[str], counted: str | None) -> int:
        model = self.model
        most = {"link": model.line.links, "node": model.free_nodes, "mode": 3 * model.free_nodes, None: 0}[counted]
        if len(where) > 1 or not where[0].isdecimal() or not 1 <= int(where[0]) <= most:
            raise self._error(f"{'.'.join(where)!r} is not a {counted or 'part'}; allowed: 1 to {most}")
        return int(where[0]) - 1

    def _number_of(self, word: str, names: Sequence[str], what: str) -> int:
        if word not in names:
            raise self._error(f"{word!r} is not a {what}; {nearest(word, names)}")
        return list(names).index(word)

    def _links(self, line: str, end: str | None = None, *more: str) -> tuple[int, ...]:
        """Links of a line, or those at one of its ends or points."""
        if end is not None:
            return self._end(line, ".".join((end, *more)))[0]
        self._number_of(line, self.model.geometry.line_names(), "line")
        return tuple(map(int, self.model.geometry.line_links([line])[line]))

    def _end(self, line: str, end: str) -> tuple[tuple[int, ...], float]:
        """The link at an end or point of a line, and 1 if it leads there, -1 if it starts there."""
        self._number_of(line, self.model.geometry.line_names(), "line")
        own = self.model.geometry.line_links([line])[line]
        near = [(member, span) for member, span in self._members() if span.start in own]
        first = ((int(own[0]),), -1.0)
        last = ((int(own[-1]),), 1.0)
        ends = {self.points[near[0][0].start]: first, self.points[near[-1][0].end]: last}
        held = [name for name in ends if self.model.geometry.held[self.points.index(name)]]
        named = {"first": first, "last": last}
        if len(held) == 1 and len(ends) == 2:
            named |= {"anchor": ends[held[0]], "fairlead": next(i for name, i in ends.items() if name != held[0])}
        inner = {self.points[member.start]: ((span.start,), -1.0) for member, span in near[1:]}
        by_name = {**inner, **ends, **named}
        if end not in by_name:
            raise self._error(f"{end!r} is not an end of line {line!r}; {nearest(end, by_name)}")
        return by_name[end]

    def _members(self) -> list[tuple[Member, slice]]:
        return list(zip(self.model.geometry.members, self.model.geometry.spans, strict=True))

    def _node(self, point: int) -> int:
        """Number of a point's node behind the free nodes, in the order of `Model.nodes`."""
        first = self.model.free_nodes
        for member, _ in self._members():
            for end, node in ((member.start, first), (member.end, first + member.links)):
                if end == point:
                    return node
            first += member.links + 1
        raise self._error(f"point {self.points[point]!r} is not an end of a line")

    def _anchor(self, signal: str, where: list[str], statistic: str) -> Quantity:
        held = [self.points[i] for i in self.model.geometry.held_points]
        self._number_of(where[0], held, "fixed point")
        if len(where) != 2:
            raise self._error(f"has no direction; allowed: {', '.join(DIRECTIONS)}")
        self._number_of(where[1], DIRECTIONS, "direction")
        point = self.points.index(where[0])
        first = [(span.start, 1.0) for member, span in self._members() if member.start == point]
        last = [(span.stop - 1, -1.0) for member, span in self._members() if member.end == point]
        links, signs = zip(*first, *last, strict=True)
        return Quantity(self.name, signal, statistic, links, signs, where[1])

    def _error(self, reason: str) -> SceneError:
        return SceneError(f"{self.option}: {self.name!r}: {reason}")
