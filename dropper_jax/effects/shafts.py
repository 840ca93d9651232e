"""Lines that twist as one: which nodes of lines are one node of a shaft."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.tridiagonal import solve_tridiagonal
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Values
from dropper_jax.effects.bending import common_ends
from dropper_jax.model import Graph
from dropper_jax.scene import SceneData


class Part(NamedTuple):
    """A line of a shaft, and whether it runs against the shaft."""

    line: str
    reversed: bool


class Shafts:
    """Nodes of shafts, one shaft after another: static arrays.

    A shaft is one line, or several that are joined. The twist about the axis of a line that runs against its shaft has
    the other sign; the difference over a link has not.

    Attributes:
        before: of links, the node before it; the next one is after it.
        twists: of links, 1.0 if the line twists.
        held: of nodes, whether the angle is given.
        turned, last: of nodes, 1.0 where `turn` turns them or `torque` acts on them; -1.0: about the other direction.
        node, sign: of the nodes of lines, line after line with both ends of each: the node of the shaft, and the sign
            of the twist there.
        line_node: of nodes, the first node of a line that is there.
    """

    def __init__(
        self, geometry: Graph, lines: Sequence[str], joined: Sequence[tuple[str, str]], held: tuple[bool, bool]
    ) -> None:
        """The shafts of the lines that twist (all if none is named), some of them joined.

        Args:
            held: whether first and last points are held.
        """
        nodes = {}
        ends = {}
        self.twists = np.zeros(geometry.links)
        for i, (member, span) in enumerate(zip(geometry.members, geometry.spans, strict=True)):
            nodes[member.name] = np.arange(span.start + i, span.stop + i + 1)
            ends[member.name] = member.start, member.end
            self.twists[span] = not lines or member.name in lines
        shafts = list(chain_lines(joined, ends))

        count = geometry.links + len(nodes)
        self.node = np.zeros(count, int)
        self.sign = np.ones(count)
        first = 0
        for shaft in shafts:
            for part in shaft:
                along = nodes[part.line]
                if part.reversed:
                    along = along[::-1]
                    self.sign[along] = -1.0
                self.node[along] = first + np.arange(len(along))
                first += len(along) - 1  # the next line of the shaft shares the last node
            first += 1
        _, self.line_node = np.unique(self.node, return_index=True)

        starts = np.concatenate([own[:-1] for own in nodes.values()])
        self.before = np.minimum(self.node[starts], self.node[starts + 1])
        self.held = np.ones(first, bool)  # lines that do not twist are held everywhere
        twisting = self.before[self.twists > 0.0]
        self.held[twisting] = False
        self.held[twisting + 1] = False
        last_points = np.zeros(first)
        for shaft in shafts:
            for name, is_last in free_ends(shaft):
                if lines and name not in lines:
                    continue
                end = nodes[name][-1 if is_last else 0]
                self.held[self.node[end]] = held[is_last]
                if is_last:
                    last_points[self.node[end]] = self.sign[end]
        self.turned = np.where(self.held, last_points, 0.0)
        self.last = np.where(self.held, 0.0, last_points)

    @property
    def one_line_each(self) -> bool:
        """Whether every shaft is one line: nodes of shafts are those of lines."""
        return len(self.line_node) == len(self.node)

    def of_lines(self, phi: Array) -> Array:
        """Twist of shafts from that of lines, both ends of each included."""
        if self.one_line_each:
            return phi
        return phi[self.line_node] * self.sign[self.line_node]

    def on_lines(self, phi: Array) -> Array:
        """Twist of lines, both ends of each included, from that of shafts."""
        if self.one_line_each:
            return phi
        return phi[self.node] * self.sign

    def differences(self, phi: Array) -> Array:
        """Over the links (n,)."""
        return phi[self.before + 1] - phi[self.before]

    def sums(self, before: Array, after: Array) -> Array:
        """Values of links (n,) for the nodes before and after them, summed on the nodes (nodes,)."""
        empty = jnp.zeros(len(self.held), before.dtype)
        return empty.at[self.before].add(before) + empty.at[self.before + 1].add(after)

    def at_nodes(self, torque: Array) -> Array:
        """Sums of torques (n,) that act on the nodes after links, and with the opposite sign on those before."""
        return self.sums(-torque, torque)

    def solve(self, diagonal: Array, between: Array, right: Array, goal: Array) -> Array:
        """x of `(diagonal + K) x = right`, K of springs `between` the nodes of links (n,), with x = goal at held
        nodes."""
        between = between * self.twists
        none = jnp.zeros_like(between)
        low = self.sums(none, -between)
        up = self.sums(-between, none)
        free = ~self.held
        own = jnp.where(free, diagonal + self.sums(between, between), 1.0)
        right = jnp.where(free, right, goal)
        return solve_tridiagonal(jnp.where(free, low, 0.0), own, jnp.where(free, up, 0.0), right)


def chain_lines(pairs: Sequence[tuple[str, str]], ends: Mapping[str, tuple[Any, Any]]) -> Iterator[list[Part]]:
    """The lines of each shaft, in order.

    Args:
        pairs: lines that are joined.
        ends: first and last point of lines by name.
    """
    joined_to = {}  # an end, as the line and 0 or 1, and the end of the other line there
    for pair in pairs:
        one, other = zip(pair, common_ends(pair, ends), strict=True)
        joined_to[one] = other
        joined_to[other] = one
    done = set()
    for end in itertools.product(ends, (0, 1)):
        if end[0] in done or end in joined_to:
            continue
        shaft = []
        while end is not None:
            line, side = end
            shaft.append(Part(line, side == 1))
            done.add(line)
            end = joined_to.get((line, 1 - side))
        yield shaft


def free_ends(shaft: Sequence[Part]) -> tuple[tuple[str, bool], tuple[str, bool]]:
    """The line at each end of a shaft, and whether the line's last point is there."""
    return (shaft[0].line, shaft[0].reversed), (shaft[-1].line, not shaft[-1].reversed)


def check_joined(values: Values, scene: SceneData) -> None:
    """Raise a `SceneError` for pairs that do not meet, an end in two pairs, a ring, or a shaft that spins freely."""
    lines = values["lines"]
    ends = {line.name: (line.start, line.end) for line in scene.lines if not lines or line.name in lines}
    seen = set()
    for i, pair in enumerate(values["joined"]):
        path = f"effects.torsion.joined.{i}"
        for name in pair:
            if name not in ends:
                raise SceneError(f"{path}: {name!r} is not a line with torsion; {nearest(name, list(ends))}")
        for end in zip(pair, common_ends(pair, ends, path), strict=True):
            if end in seen:
                raise SceneError(f"{path}: {end[0]!r} is joined to another line at this point; allowed: one pair")
            seen.add(end)
    shafts = list(chain_lines(values["joined"], ends))
    if sum(map(len, shafts)) < len(ends):
        raise SceneError("effects.torsion.joined: the lines form a ring; allowed: lines with two ends")
    lasts = [is_last for shaft in shafts for _, is_last in free_ends(shaft)]
    for key in ("torque", "turn"):
        if values[key] != 0.0 and not any(lasts):
            raise SceneError(f"effects.torsion.{key}: all last points are joined; allowed: 0")
    for shaft in shafts:
        if all(values["last" if is_last else "first"] == "free" for _, is_last in free_ends(shaft)):
            names = ", ".join(part.line for part in shaft)
            raise SceneError(
                f"effects.torsion.last: 'free' lets lines spin freely ({names}), as `first` is 'free' too or they are "
                "joined at their first points; allowed: 'held'"
            )
