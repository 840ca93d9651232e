"""References of a scene to files: below the scene's folder or the working folder, unless the caller allows others.

A scene may come from an untrusted source. The files that it refers to are read and their values are written into
results. Values given by the caller (Python, `--set`) may refer to any file.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from dropper_jax.base.errors import SceneError

_FOLDER: ContextVar[Path | None] = ContextVar("folder of the scene that is read", default=None)
OUTSIDE_HINT = "allowed: a file below the scene's folder; or use --allow-outside (load_scene(..., allow_outside=True))"


@contextmanager
def references_of(folder: Path | None) -> Iterator[None]:
    """Active while a scene of this folder is read; None: the scene may refer to any file."""
    token = _FOLDER.set(folder)
    try:
        yield
    finally:
        _FOLDER.reset(token)


def find_referenced(text: str | Path, path: str, base: Path | None = None) -> Path:
    """The file that a scene refers to at `path`.

    Args:
        base: base folder of relative names; default: the scene's folder if the file exists there, otherwise the
            working folder.

    Raises:
        SceneError: the file is outside the allowed folders.
    """
    folder = _FOLDER.get()
    if "\0" in str(text):
        raise SceneError(f"{path}: {str(text)[:60]!r} is not a valid file name (contains NUL)")
    found = (base or Path()) / text
    if base is None and folder is not None and (folder / text).exists():
        found = folder / text
    if folder is None:
        return found
    try:
        inside = any(found.resolve().is_relative_to(root.resolve()) for root in (folder, Path()))
    except (OSError, RuntimeError):  # circular links
        inside = False
    if not inside:
        raise SceneError(f"{path}: {str(text)!r} is outside the scene's folder; {OUTSIDE_HINT}")
    return found
