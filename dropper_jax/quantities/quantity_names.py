"""Names of quantities: `SIGNAL[.WHERE].STATISTIC`, such as `tension.west-leg.fairlead.max`.

One table serves all commands: `sensitivity --of`, `sweep --quantities`, `design --target`, `cases --of` and the
constraints of `optimise`. WHERE is one of

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
from dataclasses import replace

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.records import names_of
from dropper_jax.model import Model
from dropper_jax.quantities.motion_signals import DIRECTIONS, OF_ALL, SIGNALS
from dropper_jax.quantities.quantities import Quantity
from dropper_jax.quantities.statistics import NAMES, PERIOD, START

#: Examples of WHERE in messages, by what it selects; of links and modes a number.
EXAMPLES = {"anchor": "west.horizontal", "node": "buoy", "end": "leg.first.angle", "line": "leg"}
FIRST_NUMBER = "1"
#: Number of independent motions of a free node, and so of modes per free node.
MOTIONS_PER_NODE = 3
#: Sign of the angle of a link, which is that from its first to its last node and positive downwards, that makes it the
#: angle above the horizontal of a line as it leaves the point: the link starts there, or ends there.
LEAVES_FORWARDS = -1.0
LEAVES_BACKWARDS = 1.0


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
        self.points = names_of(model.points)

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
        counted = SIGNALS[signal].where
        found = Quantity(self.text, signal, wanted)
        if not where:
            if signal not in OF_ALL:
                example = EXAMPLES.get(counted or "", FIRST_NUMBER)
                raise self._error(f"has no {counted}; allowed: such as {signal}.{example}.{wanted}")
            return found
        if counted is None:
            raise self._error(f"{'.'.join(where)!r} is not a part; allowed: {signal}.{wanted}")
        if counted == "anchor":
            return self._at_anchor(found, where)
        if counted == "end":
            return self._at_end(found, where)
        if counted == "line":
            return self._at_joints(found, where)
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

    def _at_joints(self, found: Quantity, where: list[str]) -> Quantity:
        """A signal of the pairs of neighbouring links of a line, numbered by the first of each pair."""
        last = [span.stop - 1 for span in self.graph.spans]
        joints = tuple(link for link in self._links(where[0]) if link not in last)
        if len(where) > 1 or not joints:
            raise self._error(f"allowed: a line of two links or more, such as {found.signal}.leg.{found.statistic}")
        return replace(found, members=joints)

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
        most = {"link": self.model.line.links, "node": free, "mode": MOTIONS_PER_NODE * free}[counted]
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
        """The link at an end or point of a line, and the sign of its angle there (`LEAVES_FORWARDS`)."""
        own = self._links(line)
        pieces = [piece for piece in zip(self.graph.members, self.graph.spans, strict=True) if piece[1].start in own]
        first = (own[0], LEAVES_FORWARDS)
        last = (own[-1], LEAVES_BACKWARDS)
        ends = {pieces[0][0].start: first, pieces[-1][0].end: last}
        named = {"first": first, "last": last}
        held = [point for point in ends if self.graph.held[point]]
        if len(held) == 1 and len(ends) == 2:
            (other,) = ends.keys() - held
            named |= {"anchor": ends[held[0]], "fairlead": ends[other]}
        found = {self.points[member.start]: (span.start, LEAVES_FORWARDS) for member, span in pieces}
        found |= {self.points[point]: link for point, link in ends.items()} | named
        if end not in found:
            raise self._error(f"{end!r} is not an end of line {line!r}; {nearest(end, found)}")
        return found[end]

    def _error(self, reason: str) -> SceneError:
        return SceneError(f"{self.option}: {self.text!r}: {reason}")
