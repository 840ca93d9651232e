"""Patterns of names in a site's file, such as `loop-*`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Plain, read_list, read_text

#: Maximum number of names in an error message.
MAX_NAMES = 6


def match_names(patterns: Iterable[str], names: Sequence[str], path: str, what: str = "line") -> tuple[str, ...]:
    """Names that match any of the patterns, in order.

    Raises:
        SceneError: a pattern without a match (with the nearest name).
    """
    found = set()
    for pattern in patterns:
        own = [name for name in names if fnmatchcase(name, pattern)]
        if not own:
            hint = nearest(pattern, names)
            if hint.startswith("known:"):
                hint = f"known: {first_names(names)}"
            raise SceneError(f"{path}: {pattern!r} matches no {what}; {hint}")
        found.update(own)
    return tuple(name for name in names if name in found)


def read_patterns(given: Plain, path: str) -> list[str]:
    """A pattern of names, or a list of them."""
    if isinstance(given, str):
        return [given]
    return [read_text(item, path) for item in read_list(given, path, None, "patterns")]


def first_names(names: Sequence[str]) -> str:
    """The first names of a long list."""
    text = ", ".join(names[:MAX_NAMES]) or "none"
    if len(names) > MAX_NAMES:
        text += f", ... ({len(names)} in total)"
    return text
