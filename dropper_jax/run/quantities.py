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

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.fields import component, option
from dropper_jax.base.numerics import horizontal_norm, safe_norm
from dropper_jax.model import Model, Parted, State, state
from dropper_jax.model.slots import LengthOverTime, Stateful
from dropper_jax.run.end_links import load_on_fixed_point
from dropper_jax.run.statistics import NAMES, OVER_STEPS, PERIOD, START, statistic
from dropper_jax.statics.modes import natural_periods
from dropper_jax.stepping.extremes import Extremes
from dropper_jax.stepping.observe import observe
from dropper_jax.stepping.progress import Trajectory

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


@dataclass(frozen=True)
class Quantity:
    """A named number of a motion.

    Attributes:
        name: `SIGNAL[.WHERE].STATISTIC`.
        signal, statistic: its first and last part.
        members: links, modes, or nodes that it refers to, from 0; None for all. Nodes are numbered as in
            `Graph.everywhere`, the free ones first. Of an anchor these are its links.
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

    def __call__(self, model: Model, start: Array, run: Trajectory, t: Array) -> Array:
        """The number for saved states at times t (k,) [s] of a run from the free nodes `start` (nodes, 3)."""
        if self.signal == PERIOD:
            pose = state(model, start, tension=run.tension[0], t=t[0])
            return natural_periods(model, pose, self.modes)[-1]
        samples = self.in_time(model, start, run.r, run.v, run.tension, t, run.parted)
        return statistic(self.statistic, samples, t[-1] / len(t) if len(t) < 2 else t[1] - t[0])

    @partial(jax.jit, static_argnums=0, inline=True)
    def in_time(self, model: Model, start: Array, *saved: Array | Parted | None) -> Array:
        """The signal (times, members) of saved instants, given as in `instant`."""
        return jax.vmap(lambda *now: self.instant(model, start, *now))(*saved)

    @partial(jax.jit, static_argnums=0, inline=True)
    def of_pose(self, model: Model, s: State) -> Array:
        """The number at one instant, a static pose."""
        if self.signal == PERIOD:
            return natural_periods(model, s, self.modes)[-1]
        still = model
        if model.sea is not None:
            still = replace(model, sea=model.sea.without_waves())
        return statistic(self.statistic, self.instant(still, s.r, s.r, s.v, s.tension, s.t, s.parted)[None], 1.0)

    def instant(
        self,
        model: Model,
        start: Array,
        r: Array,
        v: Array,
        tension: Array,
        t: Array,
        parted: Parted | None = None,
    ) -> Array:
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

    def _of_nodes(self, model: Model, start: Array, r: Array, t: Array) -> Array:
        """The signal of all free nodes, or of all nodes if it refers to a fixed point."""
        if self.members is not None and max(self.members) >= len(r):
            held = model.ends(t).positions
            r = model.geometry.everywhere(r, held)
            start = model.geometry.everywhere(start, held)
        if self.signal == "excursion":
            return safe_norm(r - start)
        if self.signal == "offset":
            return horizontal_norm(r - model.points[self.point].position)
        if self.signal == "depth":
            return -r[:, 2]
        return r[:, "xyz".index(self.signal)]

    def _anchor_load(self, model: Model, r: Array, tension: Array, t: Array) -> Array:
        """Force of the lines on a fixed point [N], or its angle [rad]."""
        force = load_on_fixed_point(model, self.members or (), self.signs, r, tension, t)
        if self.direction == "vertical":
            return force[2]
        if self.direction == "total":
            return safe_norm(force)
        across = horizontal_norm(force)
        if self.direction == "uplift":
            return jnp.arctan2(force[2], across)
        return across


@component
class QuantitySignals:
    """Signals (n + q,) of a step whose extremes over all steps a run keeps: tensions of the links, and quantities.

    Quantities are maxima and minima; each has the extreme of its members. Without the parabola of `STATISTICS`, a
    maximum is that of the steps. See `stepping.extremes`.
    """

    start: Array
    quantities: tuple[Quantity, ...] = option("maxima and minima")

    def __call__(self, model: Model, before: State, after: State) -> tuple[Array, Array]:
        now = after.r, after.v, after.tension, after.t, after.parted
        found = [OVER_STEPS[one.statistic](one.instant(model, self.start, *now))[None] for one in self.quantities]
        return jnp.concatenate([after.tension, *found]), after.t

    def over_steps(self, extremes: Extremes) -> dict[Quantity, Array]:
        """The extreme of each quantity since the last saved time (k,), from rows (k, n + q)."""
        sides = {"max": extremes.largest, "min": extremes.least}
        first = extremes.least.shape[-1] - len(self.quantities)
        return {one: sides[one.statistic][..., first + i] for i, one in enumerate(self.quantities)}


def quantity_signals(quantities: Sequence[Quantity], start: Array) -> QuantitySignals:
    """The signals of those of the quantities that are maxima and minima, of runs from the free nodes `start`."""
    return QuantitySignals(start, tuple(one for one in quantities if one.statistic in OVER_STEPS))


def quantity(name: str, model: Model, option: str = "of") -> Quantity:
    """The quantity of a name such as `tension.3.max`, `tension.west-leg.fairlead.max`, `offset.buoy.max`.

    Args:
        option: named in messages.

    Raises:
        SceneError: an unknown signal, statistic, line or point, or a link or node that does not exist.
    """
    return _Name(name, model, option).read()


def static_quantity(name: str, model: Model, option: str) -> Quantity:
    """The same for a static pose, which needs no statistic: `tension.chain.first`, `depth.buoy`."""
    last = name.rpartition(".")[2]
    return quantity(name if last in NAMES else f"{name}.{START}", model, option)


class _Name:
    """The name of a quantity, read in a model."""

    def __init__(self, text: str, model: Model, option: str) -> None:
        self.text = text
        self.model = model
        self.option = option
        self.graph = model.geometry
        self.points = [point.name for point in model.points]

    def read(self) -> Quantity:
        """The quantity, with its members."""
        words = self.text.split(".")
        signal = words[0]
        where = words[1:-1]
        wanted = words[-1] if len(words) > 1 else ""
        self._check_word("signal", signal, SIGNALS)
        self._check_word("statistic", wanted, NAMES)
        if signal == PERIOD and wanted != START:
            raise self._error("a natural period belongs to the static pose; allowed: period.1.start")
        counted = SIGNALS[signal][1]
        found = Quantity(self.text, signal, wanted)
        if not where:
            if signal not in OF_ALL:
                example = {"anchor": "west.horizontal", "node": "buoy", "end": "leg.first.angle", "line": "leg"}
                raise self._error(f"has no {counted}; allowed: such as {signal}.{example.get(counted, '1')}.{wanted}")
            return found
        if counted is None:
            raise self._error(f"{'.'.join(where)!r} is not a part; allowed: {signal}.{wanted}")
        if counted == "anchor":
            return self._at_anchor(found, where)
        if counted == "end":
            return self._at_end(found, where)
        if counted == "line":
            last = [span.stop - 1 for span in self.graph.spans]
            joints = tuple(link for link in self._links(where[0]) if link not in last)
            if len(where) > 1 or not joints:
                raise self._error(f"allowed: a line of two links or more, such as {signal}.leg.{wanted}")
            return replace(found, members=joints)
        if where[0].isdecimal() or counted == "mode":
            return replace(found, members=(self._number(where, counted),))
        if counted == "link":
            return replace(found, members=self._links(*where))
        if len(where) > 1:
            raise self._error(f"{'.'.join(where)!r} is not a point; {nearest(where[0], self.points)}")
        point = self._index(where[0], self.points, "point")
        return replace(found, members=(int(self.graph.point_node[point]),), point=point)

    def _check_word(self, what: str, word: str, known: Collection[str]) -> None:
        if word not in known:
            hint = f"{nearest(word, known)}; allowed: SIGNAL[.WHERE].STATISTIC, such as tension.max"
            raise self._error(f"{word!r} is not a {what}; {hint}")

    def _at_anchor(self, found: Quantity, where: list[str]) -> Quantity:
        """A force on a fixed point: of the lines that end there, in a direction."""
        held = [self.points[i] for i in self.graph.held_points]
        self._index(where[0], held, "fixed point")
        if len(where) != 2:
            raise self._error(f"has no direction; allowed: {', '.join(DIRECTIONS)}")
        self._index(where[1], DIRECTIONS, "direction")
        point = self.points.index(where[0])
        members = []
        signs = []
        for member, span in zip(self.graph.members, self.graph.spans, strict=True):
            if member.start == point:
                members.append(span.start)
                signs.append(1.0)
            if member.end == point:
                members.append(span.stop - 1)
                signs.append(-1.0)
        return replace(found, members=tuple(members), signs=tuple(signs), direction=where[1])

    def _at_end(self, found: Quantity, where: list[str]) -> Quantity:
        """The tension or the angle of a line at an end."""
        signal = where[-1]
        if len(where) != 3 or signal not in ("tension", "angle"):
            raise self._error(f"has no end and signal; allowed: such as line.leg.fairlead.angle.{found.statistic}")
        link, sign = self._end(*where[:2])
        found = replace(found, signal=signal, members=(link,))
        if signal == "angle":
            return replace(found, signs=(sign,))
        return found

    def _number(self, where: list[str], counted: str) -> int:
        """Number from 0 of a link, a free node or a mode."""
        free = self.model.free_nodes
        most = {"link": self.model.line.links, "node": free, "mode": 3 * free}[counted]
        if len(where) > 1 or not where[0].isdecimal() or not 1 <= int(where[0]) <= most:
            raise self._error(f"{'.'.join(where)!r} is not a {counted}; allowed: 1 to {most}")
        return int(where[0]) - 1

    def _index(self, word: str, names: Sequence[str], what: str) -> int:
        """Number of a name among those of all `what`, checked."""
        if word not in names:
            raise self._error(f"{word!r} is not a {what}; {nearest(word, names)}")
        return names.index(word)

    def _links(self, line: str, *end: str) -> tuple[int, ...]:
        """Links of a line, or the one at one of its ends or points."""
        if end:
            return (self._end(line, ".".join(end))[0],)
        self._index(line, self.graph.line_names(), "line")
        return tuple(self.graph.line_links([line])[line].tolist())

    def _end(self, line: str, end: str) -> tuple[int, float]:
        """The link at an end or point of a line, and 1 if it leads there, -1 if it starts there."""
        own = self._links(line)
        pieces = [
            member for member, span in zip(self.graph.members, self.graph.spans, strict=True) if span.start in own
        ]
        first = (own[0], -1.0)
        last = (own[-1], 1.0)
        ends = {pieces[0].start: first, pieces[-1].end: last}
        named = {"first": first, "last": last}
        held = [point for point in ends if self.graph.held[point]]
        if len(held) == 1 and len(ends) == 2:
            (other,) = ends.keys() - held
            named |= {"anchor": ends[held[0]], "fairlead": ends[other]}
        found = {}
        start = own[0]
        for piece in pieces:
            found[self.points[piece.start]] = (start, -1.0)
            start += piece.links
        found |= {self.points[point]: link for point, link in ends.items()} | named
        if end not in found:
            raise self._error(f"{end!r} is not an end of line {line!r}; {nearest(end, found)}")
        return found[end]

    def _error(self, reason: str) -> SceneError:
        return SceneError(f"{self.option}: {self.text!r}: {reason}")
