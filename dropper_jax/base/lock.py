"""A lock on a folder that one process at a time fills; the system lets go of it when its owner ends."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path
from typing import BinaryIO

from dropper_jax.base.errors import SceneError

try:
    import fcntl
except ImportError:  # Windows: no lock
    fcntl = None


class Lock:
    """Held from when it is made until `release`; `.NAME.lock` beside the folder names its owner.

    Raises:
        SceneError: another process holds it, with its number and machine.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder.with_name(f".{folder.name}.lock")
        self._file: BinaryIO | None = None
        if fcntl is None:
            return
        try:
            while True:
                file = open(self.path, "a+b")  # noqa: SIM115 - as long as the lock is held
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    owner = _owner(file)
                    file.close()
                    raise SceneError(f"{folder}: is being filled by {owner}; allowed: when that has ended") from None
                if _is_there(self.path, file):
                    break
                file.close()  # its owner removed it just now
        except OSError as error:
            reason = f"cannot be written: {error.strerror or error}"
            raise SceneError(f"{folder}: {reason}") from None
        self._file = file
        file.truncate(0)
        file.write(json.dumps({"process": os.getpid(), "machine": socket.gethostname()}).encode())
        file.flush()

    def release(self) -> None:
        """Let go, and remove the file."""
        if self._file is not None:
            self.path.unlink(missing_ok=True)
            self._file.close()
            self._file = None


def _is_there(path: Path, file: BinaryIO) -> bool:
    """Whether the open file is still the one of that name."""
    try:
        return os.path.samestat(path.stat(), os.fstat(file.fileno()))
    except OSError:
        return False


def _owner(file: BinaryIO) -> str:
    """The owner in words."""
    try:
        file.seek(0)
        found = json.loads(file.read())
        return f"process {int(found['process'])} on {str(found['machine'])[:60]}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
