"""Files that a scene names: below its own folder or the working folder, unless the caller allows others.

A scene may come from anybody; what it names is read and its values are written into results. Values that a caller
gives (Python, `--set`) are the caller's own and may name any file.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from dropper_jax.base.errors import SceneError

_FOLDER: ContextVar[Path | None] = ContextVar("folder of the scene that is read", default=None)
HINT = "allowed: a file below the scene's folder, or --allow-outside (load_scene(..., allow_outside=True))"


@contextmanager
def references_of(folder: Path | None) -> Iterator[None]:
    """While a scene of this folder is read; None: it may name any file."""
    token = _FOLDER.set(folder)
    try:
        yield
    finally:
        _FOLDER.reset(token)


def find_referenced(text: str | Path, path: str, beside: Path | None = None) -> Path:
    """The file that a scene names at `path`.

    Args:
        beside: folder from which the name counts; default: the scene's where the file is there, else the working one.

    Raises:
        SceneError: it is elsewhere.
    """
    folder = _FOLDER.get()
    if "\0" in str(text):
        raise SceneError(f"{path}: {str(text)[:60]!r} is no name of a file; allowed: one without NUL")
    if beside is not None:
        found = beside / text
    else:
        own = None if folder is None else folder / text
        found = own if own is not None and own.exists() else Path(text)
    if folder is None:
        return found
    try:
        there = found.resolve()
        inside = any(there.is_relative_to(root.resolve()) for root in (folder, Path()))
    except (OSError, RuntimeError):  # links that go round
        inside = False
    if not inside:
        raise SceneError(f"{path}: {str(text)!r} is outside the scene's folder; {HINT}")
    return found
