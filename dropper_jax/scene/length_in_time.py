"""`[[line.length_in_time]]`: links at an end of a line, or one link, whose unstretched length changes in time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from dropper_jax.base.errors import Check, SceneError, raise_first
from dropper_jax.base.fields import option, parameter, section
from dropper_jax.base.read import DeclaredSection, Plain, count, part, plain, read_table, refuse, short_text

#: Relative difference between the first row of a table and the length of the links in the scene that is rounding.
SAME_LENGTH = 1e-6


@section
class WinchSpec(DeclaredSection):
    """`control` of `[[line.length_in_time]]`: a winch that keeps the tension of the end link near a target."""

    target: float = parameter("tension to which it pays out and hauls in", unit="N", low=0.0)
    gain: np.ndarray = parameter(
        "rate per tension above the target [m/s/N], and its rate per time [m/s^2/N]",
        unit="-",
        shape="table",
        low=0.0,
        entries=2,
    )
    limits: np.ndarray = parameter(
        "fastest hauling in (negative) and paying out of the drum", unit="m/s", shape="table", entries=2
    )
    lengths: np.ndarray = parameter(
        "shortest and longest length of the links",
        unit="m",
        shape="table",
        above=0.0,
        rising=2,
        entries=2,
    )

    def checks(self) -> Iterator[Check]:
        yield (
            not self.limits[0] <= 0.0 <= self.limits[1],
            f"limits: {short_text(plain(self.limits))} does not contain 0; allowed: [-rate, rate] in m/s",
        )


@section
class LengthInTimeSpec(DeclaredSection):
    """`[[line.length_in_time]]`: unstretched length over time, for lines that stretch; a table, or a winch."""

    end: str | None = option("end next to the links", choices=("from", "to"), default=None)
    links: int | None = count("number of links nearest that end; 1 if omitted", default=None)
    link: int | None = count("one link, from 1, in place of `end`", default=None)
    time: np.ndarray | None = parameter("times of the rows", unit="s", shape="table", rising=2, default=None)
    length: np.ndarray | None = parameter(
        "total unstretched length of the links at those times",
        unit="m",
        shape="table",
        above=0.0,
        default=None,
    )
    between: str = option("length between the rows", choices=("linear", "smooth"), default="linear")
    control: WinchSpec | None = part(WinchSpec.read, default=None)

    def numbers(self, total: int) -> range:
        """The links, from 0, of a line of `total` links."""
        if self.link is not None:
            return range(self.link - 1, self.link)
        links = self.links or 1
        if self.end == "from":
            return range(links)
        return range(total - links, total)

    def checks(self) -> Iterator[Check]:
        yield (self.end is None) == (self.link is None), ": needs `end` ('from' or 'to'), or `link`; one of them"
        yield self.link is not None and self.links is not None, "links: belongs to `end`. Leave it out"
        given = self.time is not None and self.length is not None
        yield (
            given == (self.control is not None) or (self.time is None) != (self.length is None),
            ": needs `time` [s] and `length` [m], or `control`; one of the two",
        )
        yield self.control is not None and self.link is not None, "link: a winch is at an end. Use `end`"
        if given:
            times = len(self.time)
            rows = len(self.length)
            yield rows != times, f"length: has {rows} rows; allowed: {times}, as many as `time`"

    def line_checks(self, name: str, length: np.ndarray, rigid: bool) -> Iterator[Check]:
        """Checks of the entry against its line, with links of these lengths (n,) [m]."""
        yield rigid, f": the links of {name!r} are rigid. Use a line that stretches, such as axial.law = 'rope'"
        links = len(length)
        for key, many in (("links", self.links or 1), ("link", self.link or 1)):
            yield many > links, f"{key}: {many}, but {name!r} has {links} links; allowed: 1 to {links}"
        total = np.sum(length[list(self.numbers(links))])
        if self.control is not None:
            low, high = self.control.lengths
            yield (
                not low <= total <= high,
                f"control.lengths: {low:g} to {high:g} m, but these links of {name!r} are {total:.9g} m long; "
                "allowed: a range that contains their length",
            )
        elif self.time is not None and self.length is not None:
            first = np.interp(0.0, self.time, self.length)
            yield (
                abs(first - total) > SAME_LENGTH * total,
                f"length: {first:.9g} m at t = 0, but these links of {name!r} are {total:.9g} m long; allowed: "
                f"{total:.9g}, or another `length` of the line",
            )

    def check_run(self, path: str, duration: float) -> None:
        """Check that the table covers a run."""
        if self.time is not None and (self.time[0] > 0.0 or self.time[-1] < duration):
            raise SceneError(
                f"{path}.time: {self.time[0]:g} to {self.time[-1]:g} s, but the run lasts from 0 to {duration:g} s; "
                "allowed: a table of the full run"
            )


def check_changing_lengths(
    items: tuple[LengthInTimeSpec, ...], path: str, name: str, length: np.ndarray, rigid: bool
) -> None:
    """Check the entries of a line against its links (n,) [m], and against each other."""
    taken: set[int] = set()
    for i, item in enumerate(items):
        raise_first(item.line_checks(name, length, rigid), f"{path}.{i}")
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
    piece_at = {"from": found[0], "to": found[-1]}
    for i, item in enumerate(items):
        end = read_table(item, f"{path}.{i}").get("end")
        if end not in ("from", "to"):
            raise SceneError(f"{path}.{i}.end: missing; a line with attached points needs `end`, 'from' or 'to'")
        piece_at[end].append(item)
    return found
