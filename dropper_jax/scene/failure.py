"""`[[failure]]`: where, and at which load or time, a line breaks.

An entry watches the links of one line, or one of them. It acts at the end of the first step in which the tension of a
watched link reaches its load, or that reaches the time. One link then breaks: the specified one, otherwise the one with
the largest ratio of tension to load. From then on it carries no tension; its mass and water forces stay with its two
nodes. An entry acts once. Statics ignore failures. Which link breaks and when has no derivative: gradients are those of
the run with its breaks at fixed times.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from dropper_jax.base.errors import Check, nearest
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import DeclaredSection, count
from dropper_jax.scene.line import LineSpec


@dataclass(frozen=True)
class FailureSpec(DeclaredSection):
    """`[[failure]]`: where, and at which load or time, a line breaks."""

    line: str = option("name of the line", type=str)
    link: int | None = count("link that breaks, from 1", default=None)
    load: float | None = parameter(
        "tension at which it breaks; the line's breaking load by default",
        unit="N",
        above=0.0,
        default=None,
    )
    time: float | None = parameter("time at which it breaks", unit="s", above=0.0, default=None)

    def line_checks(self, lines: dict[str, LineSpec]) -> Iterator[Check]:
        """Checks against the lines by name: one that stretches, the link, and a load or a time."""
        if self.line not in lines:
            hint = f"is not a line; {nearest(self.line, lines)}"
            pieces = [name for name, line in lines.items() if line.piece_of == self.line]
            if pieces:
                hint = f"is cut by its attached points; allowed: one of its pieces, {pieces[0]} to {pieces[-1]}"
            yield True, f"line: {self.line!r} {hint}"
        line = lines[self.line]
        yield line.rigid, f"line: the links of {self.line!r} are rigid. Use a line that stretches"
        yield (
            self.link is not None and self.link > line.links,
            f"link: {self.link} is not a link of {self.line!r}; allowed: 1 to {line.links}",
        )
        yield (
            self.time is not None and self.link is None,
            f"link: missing; a failure at a time needs the link that breaks, 1 to {line.links}",
        )
        yield (
            self.load is None and self.time is None and line.breaking_load is None,
            "load: missing; needed without `time` if the line has no breaking_load",
        )
