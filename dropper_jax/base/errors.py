"""Errors in the user's input, one line with the field, its value and what is allowed."""

from __future__ import annotations

import difflib
import functools
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, ParamSpec

Arguments = ParamSpec("Arguments")


class SceneError(ValueError):
    """A scene, option or combination that cannot be used; the message is one line for the user."""


def unreadable(file: object, error: OSError) -> SceneError:
    """The error for a file that the system does not let us read."""
    return SceneError(f"{file}: cannot be read: {error.strerror or error}")


class LocatedValues(dict[str, Any]):
    """Plain values of a scene read from a file, and the line number of each path in it, such as `line.0`."""

    def __init__(self, values: Mapping[str, Any], file: str, lines: Mapping[str, int]) -> None:
        super().__init__(values)
        self.file = file
        self.lines = lines

    def with_line(self, error: SceneError) -> SceneError:
        """The error with the file name and the line number of the longest path that its message starts with."""
        path = str(error).partition(":")[0]
        while path and path not in self.lines:
            path = path.rpartition(".")[0]
        if not path:
            return SceneError(f"{self.file}: {error}")
        return SceneError(f"{self.file}:{self.lines[path]}: {error}")


class SimulationError(RuntimeError):
    """A run that did not end with status `ok`; `.solution` holds the partial solution."""

    def __init__(self, message: str, solution: object = None) -> None:
        super().__init__(message)
        self.solution = solution


#: Whether something is wrong, and the message of its error.
Check = tuple[bool, str]


def raise_first(checks: Iterable[Check], path: str = "") -> None:
    """Raise the error of the first check that fails; later ones are not evaluated.

    Args:
        path: of the section whose checks they are; their messages start with a key of it, or with `:` for the whole.
    """
    for wrong, message in checks:
        if wrong:
            if path and not message.startswith(":"):
                path += "."
            raise SceneError(path + message)


def raises_first(checks: Callable[Arguments, Iterator[Check]]) -> Callable[Arguments, None]:
    """Make a function of its checks, which raises the error of the first one that fails."""

    @functools.wraps(checks)
    def check(*args: Arguments.args, **kwargs: Arguments.kwargs) -> None:
        raise_first(checks(*args, **kwargs))

    return check


def first_failure(statuses: Iterable[str]) -> str | None:
    """The first status that is not `ok`; None if all are."""
    for status in statuses:
        if status != "ok":
            return status
    return None


def nearest(word: str, candidates: Iterable[str]) -> str:
    """A hint with the nearest valid name, or with all valid names if none is similar."""
    candidates = sorted(candidates)
    if not candidates:
        return "none exist"
    close = difflib.get_close_matches(word, candidates, n=1)
    if close:
        return f"did you mean {close[0]!r}?"
    return f"known: {', '.join(candidates)}"


def require_positive(option: str, value: float, unit: str) -> None:
    """Reject a number that is not above 0 and finite.

    Args:
        option: what the message starts with.
        unit: as printed after a number, such as `" s"`.
    """
    if not 0 < value < float("inf"):
        problem = "infinite" if value == float("inf") else "not positive"
        raise SceneError(f"{option}: {value} is {problem}; allowed: > 0{unit}")
