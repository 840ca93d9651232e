"""Lines that twist as one: which nodes of lines are one node of a shaft."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.tridiagonal import solve_tridiagonal
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Values
from dropper_jax.effects.bending import common_ends
from dropper_jax.model import Graph
from dropper_jax.scene import SceneData

#: A line, and whether it runs against its shaft.
Part = tuple[str, bool]


class Shafts:
    """Nodes of shafts, one shaft after another: static arrays.

    A line is a shaft, or several that are joined. The twist about the axis of a line that runs against its shaft has
    the other sign; the difference over a link has not.

    Attributes:
        before: of links, the node before it; the next one is after it.
        twists: of links, 1.0 if the line twists.
        held: of nodes, whether the angle is given.
        turned, last: of nodes, 1.0 where `turn` turns them or `torque` acts on them; -1.0: about the other direction.
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

        # of nodes line after line, both ends of each included: the node of the shaft, and the sign of the twist
        count = geometry.links + len(nodes)
        self.node = np.zeros(count, int)
        self.sign = np.ones(count)
        following = 0
        for shaft in shafts:
            for position, (name, against) in enumerate(shaft):
                along = nodes[name]
                if against:
                    along = along[::-1]
                    self.sign[along] = -1.0
                if position > 0:  # it shares its first node with the line before
                    following -= 1
                self.node[along] = following + np.arange(len(along))
                following += len(along)
        _, self.line_node = np.unique(self.node, return_index=True)

        starts = np.concatenate([own[:-1] for own in nodes.values()])
        self.before = np.minimum(self.node[starts], self.node[starts + 1])
        self.held = np.ones(following, bool)
        self.held[self.before[self.twists > 0.0]] = False
        self.held[self.before[self.twists > 0.0] + 1] = False
        ended = np.zeros(following)
        for shaft in shafts:
            for name, is_last in free_ends(shaft):
                if lines and name not in lines:
                    continue
                at = nodes[name][-is_last]
                self.held[self.node[at]] = held[is_last]
                if is_last:
                    ended[self.node[at]] = self.sign[at]
        self.turned = np.where(self.held, ended, 0.0)
        self.last = np.where(self.held, 0.0, ended)

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
        """x of `(diagonal + K) x = right`, K of springs `between` the nodes of links (n,), with x = goal at prescribed
        nodes."""
        between = between * self.twists
        low = self.sums(jnp.zeros_like(between), -between)
        up = self.sums(-between, jnp.zeros_like(between))
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
    across = {}
    for pair in pairs:
        one, other = zip(pair, common_ends(pair, ends), strict=True)
        across[one] = other
        across[other] = one
    done = set()
    for entered in itertools.product(ends, (0, 1)):
        if entered[0] in done or entered in across:
            continue
        shaft = []
        while entered is not None:
            line, side = entered
            shaft.append((line, side == 1))
            done.add(line)
            entered = across.get((line, 1 - side))
        yield shaft


def free_ends(shaft: Sequence[Part]) -> tuple[Part, Part]:
    """The line at each end of a shaft, and whether the line's last point is there."""
    first, first_against = shaft[0]
    last, last_against = shaft[-1]
    return (first, first_against), (last, not last_against)


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
            names = ", ".join(name for name, _ in shaft)
            raise SceneError(
                f"effects.torsion.last: 'free' lets lines spin freely ({names}), as `first` is 'free' too or they are "
                "joined at their first points; allowed: 'held'"
            )
