"""Errors in the user's input, one line with the field, its value and what is allowed; progress of long computations."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping
from typing import Any


class SceneError(ValueError):
    """A scene, option or combination that cannot be used; the message is one line for the user."""


class LocatedValues(dict[str, Any]):
    """Plain values of a scene read from a file, and the line number of each path in it, such as `line.0`."""

    def __init__(self, values: Mapping[str, Any], file: str, lines: Mapping[str, int]) -> None:
        super().__init__(values)
        self.file, self.lines = file, lines

    def with_line(self, error: SceneError) -> SceneError:
        """The error with the file name and the line number of the longest path that its message starts with."""
        words = str(error).partition(":")[0].split(".")
        ends = range(len(words), 0, -1)
        line = next((self.lines[path] for end in ends if (path := ".".join(words[:end])) in self.lines), None)
        return SceneError(f"{self.file}{f':{line}' if line else ''}: {error}")


class SimulationError(RuntimeError):
    """A run that did not end with status `ok`; `.solution` holds the partial solution."""

    def __init__(self, message: str, solution: object = None) -> None:
        super().__init__(message)
        self.solution = solution


def nearest(word: str, candidates: Iterable[str]) -> str:
    """A hint with the nearest valid name, or with all valid names if none is similar."""
    candidates = sorted(candidates)
    close = difflib.get_close_matches(word, candidates, n=1)
    return f"did you mean {close[0]!r}?" if close else f"known: {', '.join(candidates)}"


#: Called with the completed fraction, 0 to 1, and a few words.
Progress = Callable[[float, str], None]


def silent(fraction: float, text: str) -> None:
    """Progress callback that does nothing."""
