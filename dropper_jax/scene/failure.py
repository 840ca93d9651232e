"""`[[failure]]`: where, and at which load or time, a line breaks.

An entry watches the links of one line, or one of them. It acts at the end of the first step in which the tension of a
watched link reaches its load, or that reaches the time. One link then breaks: the specified one, otherwise the one with
the largest ratio of tension to load. From then on it carries no tension; its mass and water forces stay with its two
nodes. An entry acts once. Statics ignore failures. Which link breaks and when has no derivative: gradients are those of
the run with its breaks at fixed times.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from dropper_jax.base.errors import Check, SceneError, nearest, raises_first
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import Plain, SectionValues, read_fields
from dropper_jax.scene.line import LineSpec


@dataclasses.dataclass(frozen=True)
class FailureSpec(SectionValues):
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
        default=None,
    )
    time: float | None = parameter("time at which it breaks", unit="s", low=0.0, open_low=True, default=None)

    @classmethod
    def read(cls, table: Plain, path: str, lines: tuple[LineSpec, ...]) -> FailureSpec:
        """A checked entry.

        Raises:
            SceneError: an unknown line, a link that the line does not have, a line that does not stretch, a time
                without a link, or neither load nor time if the line has no breaking load.
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
        spec._check(path, lines[names.index(spec.line)])
        return spec

    @raises_first
    def _check(self, path: str, line: LineSpec) -> Iterator[Check]:
        yield line.rigid, f"{path}.line: the links of {self.line!r} are rigid. Use a line that stretches"
        yield (
            self.link is not None and self.link > line.links,
            f"{path}.link: {self.link} is not a link of {self.line!r}; allowed: 1 to {line.links}",
        )
        yield (
            self.time is not None and self.link is None,
            f"{path}.link: missing; a failure at a time needs the link that breaks, 1 to {line.links}",
        )
        yield (
            self.load is None and self.time is None and line.breaking_load is None,
            f"{path}.load: missing; needed without `time` if the line has no breaking_load",
        )
