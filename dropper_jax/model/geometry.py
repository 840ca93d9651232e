"""The lines of a graph, and the motion of its fixed points at an instant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from jax import Array


class Ends(NamedTuple):
    """Fixed points, in the order of `Graph.held_points`: positions (held, 3) [m], velocities [m/s] (None: at
    rest)."""

    positions: Array
    velocities: Array | None = None

    @property
    def start(self) -> Array:
        """Start point of a single line (3,) [m]."""
        return self.positions[0]

    @property
    def end(self) -> Array | None:
        """End point of a single line (3,) [m]; None if that end is free."""
        if self.positions.shape[0] > 1:
            return self.positions[1]
        return None


class Member(NamedTuple):
    """One line: its name, its number of links and the numbers of its start and end points.

    Attributes:
        far: True, as in a path: a link's mass and forces go to its far node. False: half of them to each of its nodes.
    """

    name: str
    links: int
    start: int
    end: int
    far: bool = False

    @property
    def near_share(self) -> float:
        """Fraction of a link's mass and forces at its first node."""
        return 0.0 if self.far else 0.5


def line_number(line: str | int, names: Sequence[str]) -> int:
    """The number of a line, by name or number."""
    if line in names:
        return names.index(line)
    if isinstance(line, int) and 0 <= line < len(names):
        return line
    raise ValueError(f"line: {line!r} is unknown; allowed: {', '.join(names)} or 0 to {len(names) - 1}")
