"""Writing files so that an interrupted run never leaves half of one."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from dropper_jax.base.errors import SceneError


def read_lines(path: Path) -> list[str]:
    """The lines of a text file in UTF-8.

    Raises:
        SceneError: it is not there, or is no such text.
    """
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None


def atomic_write(path: str | Path, content: bytes | str | Callable[[BinaryIO], object]) -> Path:
    """Write a file under a temporary name in its folder, then rename it.

    Args:
        path: the file; an existing one is replaced only once the new one is complete.
        content: what to write, text as UTF-8, or a function that writes to the open binary file.

    Returns:
        The path.
    """
    path = Path(path)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            if callable(content):
                content(file)
            else:
                file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o666 & ~_umask())  # mkstemp makes files private, others expect the usual rights
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    return path


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
