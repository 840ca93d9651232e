"""Errors that a user can mend: one line with the field, its value, what is allowed."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class SceneError(ValueError):
    """A scene, an option or a pairing that cannot be used; the message is one line for the user."""


class SimulationError(RuntimeError):
    """A run that did not end with status `ok`; carries the partial solution as `.solution`."""

    def __init__(self, message: str, solution: object = None) -> None:
        super().__init__(message)
        self.solution = solution


def nearest(word: str, known: Iterable[str]) -> str:
    """A hint naming the nearest valid name, or all valid names when nothing is near."""
    known = sorted(known)
    close = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {close[0]!r}?" if close else f"known: {', '.join(known)}"
