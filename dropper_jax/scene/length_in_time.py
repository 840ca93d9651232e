"""`[[line.length_in_time]]`: links at an end of a line, or one link, whose unstretched length changes in time."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from dropper_jax.base.errors import Check, SceneError, raises_first
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import DeclaredSection, Plain, part, plain, read_table, refuse, rises, short_text

#: Relative difference between the first row of a table and the length of the links in the scene that is rounding.
SAME_LENGTH = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class WinchSpec(DeclaredSection):
    """`control` of `[[line.length_in_time]]`: a winch that keeps the tension of the end link near a target."""

    target: float = parameter("tension to which it pays out and hauls in", unit="N", low=0.0)
    gain: np.ndarray = parameter(
        "rate per tension above the target [m/s/N], and its rate per time [m/s^2/N]", unit="-", shape="table", low=0.0
    )
    limits: np.ndarray = parameter(
        "fastest hauling in (negative) and paying out of the drum", unit="m/s", shape="table"
    )
    lengths: np.ndarray = parameter(
        "shortest and longest length of the links", unit="m", shape="table", low=0.0, open_low=True
    )

    @raises_first
    def check(self, path: str) -> Iterator[Check]:
        for key in ("gain", "limits", "lengths"):
            value = getattr(self, key)
            yield len(value) != 2, f"{path}.{key}: {short_text(plain(value))} has {len(value)} entries; allowed: 2"
        yield (
            not self.limits[0] <= 0.0 <= self.limits[1],
            f"{path}.limits: {short_text(plain(self.limits))} does not contain 0; allowed: [-rate, rate] in m/s",
        )
        yield (
            not self.lengths[0] < self.lengths[1],
            f"{path}.lengths: {short_text(plain(self.lengths))} does not rise; allowed: [shortest, longest] in m",
        )


@dataclasses.dataclass(frozen=True, eq=False)
class LengthInTimeSpec(DeclaredSection):
    """`[[line.length_in_time]]`: unstretched length over time, for lines that stretch; a table, or a winch."""

    end: str | None = option("end next to the links", choices=("from", "to"), default=None)
    links: int | None = dataclasses.field(
        metadata={"kind": "option", "meaning": "number of links nearest that end; 1 if omitted", "type": int, "low": 1},
        default=None,
    )
    link: int | None = dataclasses.field(
        metadata={"kind": "option", "meaning": "one link, from 1, in place of `end`", "type": int, "low": 1},
        default=None,
    )
    time: np.ndarray | None = parameter("times of the rows", unit="s", shape="table", default=None)
    length: np.ndarray | None = parameter(
        "total unstretched length of the links at those times",
        unit="m",
        shape="table",
        low=0.0,
        open_low=True,
        default=None,
    )
    between: str = option("length between the rows", choices=("linear", "smooth"), default="linear")
    control: WinchSpec | None = part(WinchSpec.read, default=None)

    def numbers(self, count: int) -> range:
        """The links, from 0, of a line of `count` links."""
        if self.link is not None:
            return range(self.link - 1, self.link)
        links = self.links or 1
        if self.end == "from":
            return range(links)
        return range(count - links, count)

    @raises_first
    def check(self, path: str) -> Iterator[Check]:
        yield (self.end is None) == (self.link is None), f"{path}: needs `end` ('from' or 'to'), or `link`; one of them"
        yield self.link is not None and self.links is not None, f"{path}.links: belongs to `end`. Leave it out"
        given = self.time is not None and self.length is not None
        yield (
            given == (self.control is not None) or (self.time is None) != (self.length is None),
            f"{path}: needs `time` [s] and `length` [m], or `control`; one of the two",
        )
        yield self.control is not None and self.link is not None, f"{path}.link: a winch is at an end. Use `end`"
        if not given:
            return
        rows = len(self.time)
        yield (
            not rises(self.time, 2),
            f"{path}.time: {short_text(plain(self.time))} does not rise; allowed: two or more rising times [s]",
        )
        yield (
            len(self.length) != rows,
            f"{path}.length: has {len(self.length)} rows; allowed: {rows}, as many as `time`",
        )

    @raises_first
    def check_line(self, path: str, name: str, length: np.ndarray, rigid: bool) -> Iterator[Check]:
        """Check the entry against its line, with links of these lengths (n,) [m]."""
        yield rigid, f"{path}: the links of {name!r} are rigid. Use a line that stretches, such as axial.law = 'rope'"
        count = len(length)
        key = "links" if self.link is None else "link"
        many = self.link or self.links or 1
        yield many > count, f"{path}.{key}: {many}, but {name!r} has {count} links; allowed: 1 to {count}"
        total = float(np.sum(length[list(self.numbers(count))]))
        if self.time is not None and self.length is not None:
            first = float(np.interp(0.0, self.time, self.length))
            yield (
                abs(first - total) > SAME_LENGTH * total,
                f"{path}.length: {first:.9g} m at t = 0, but these links of {name!r} are {total:.9g} m long; allowed: "
                f"{total:.9g}, or another `length` of the line",
            )
            return
        if self.control is None:
            return
        low, high = self.control.lengths
        yield (
            not low <= total <= high,
            f"{path}.control.lengths: {low:g} to {high:g} m, but these links of {name!r} are {total:.9g} m long; "
            "allowed: a range that contains their length",
        )

    @raises_first
    def check_run(self, path: str, duration: float) -> Iterator[Check]:
        """Check that the table covers a run."""
        if self.time is None:
            return
        first = float(self.time[0])
        last = float(self.time[-1])
        yield (
            first > 0.0 or last < duration,
            f"{path}.time: {first:g} to {last:g} s, but the run lasts from 0 to {duration:g} s; allowed: a table of "
            "the full run",
        )


def check_changing_lengths(
    items: tuple[LengthInTimeSpec, ...], path: str, name: str, length: np.ndarray, rigid: bool
) -> None:
    """Check the entries of a line against its links (n,) [m], and against each other."""
    taken: set[int] = set()
    for i, item in enumerate(items):
        item.check_line(f"{path}.{i}", name, length, rigid)
        own = item.numbers(len(length))
        twice = taken.intersection(own)
        if twice:
            raise refuse(f"{path}.{i}", min(twice) + 1, "is a link of an earlier entry", "each link once")
        taken.update(own)


def of_pieces(items: Plain, path: str, pieces: int) -> list[Any]:
    """The entries of a line with attached points for each of its pieces: those of its ends.

    Raises:
        SceneError: an entry names a link, whose number depends on the attached points.
    """
    found: list[Any] = [[] for _ in range(pieces)]
    for i, item in enumerate(items):
        end = read_table(item, f"{path}.{i}").get("end")
        if end not in ("from", "to"):
            raise SceneError(f"{path}.{i}.end: missing; a line with attached points needs `end`, 'from' or 'to'")
        found[0 if end == "from" else -1].append(item)
    return found
