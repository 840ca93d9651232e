"""Progress of long computations."""

from __future__ import annotations

from collections.abc import Callable

#: Called with the completed fraction, 0 to 1, and a few words.
Progress = Callable[[float, str], None]


def part_of(progress: Progress, low: float, high: float) -> Progress:
    """Progress of a stage of a computation, whose 0 and 1 are `low` and `high` of the whole."""
    return lambda fraction, text: progress(low + fraction * (high - low), text)


def silent(fraction: float, text: str) -> None:
    """Progress callback that does nothing."""
