"""Progress reports of long computations."""

from __future__ import annotations

from collections.abc import Callable

#: Called with the completed fraction, 0 to 1, and a few words.
Progress = Callable[[float, str], None]


def silent(fraction: float, text: str) -> None:
    """Progress callback that does nothing."""
