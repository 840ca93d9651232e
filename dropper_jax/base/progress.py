"""How long work tells whoever waits for it."""

from __future__ import annotations

from collections.abc import Callable

#: Called with the share that is done, 0 to 1, and a few words.
Progress = Callable[[float, str], None]


def silent(fraction: float, text: str) -> None:
    """The progress of nobody who listens."""
