"""Lock of a folder against other processes."""

from __future__ import annotations

import json
import os
import socket
from contextlib import suppress
from pathlib import Path

from dropper_jax.base.errors import SceneError


class Lock:
    """Locked from construction until `release`; `.NAME.lock` next to the folder names the owner.

    Raises:
        SceneError: another process holds the lock; the message gives its number and machine.
    """

    def __init__(self, folder: Path) -> None:
        from filelock import FileLock, Timeout  # noqa: PLC0415 - 30 ms that only writing needs

        self.path = folder.with_name(f".{folder.name}.lock")
        self._lock = FileLock(self.path)
        try:
            self._lock.acquire(blocking=False)
        except Timeout:
            raise SceneError(f"{folder}: locked by {_owner(self.path)}; try again when it has finished") from None
        except OSError as error:
            raise SceneError(f"{folder}: cannot be written: {error.strerror or error}") from None
        with suppress(OSError):  # Windows also locks the contents of the file
            self.path.write_text(json.dumps({"process": os.getpid(), "machine": socket.gethostname()}))

    def release(self) -> None:
        """Remove the file and release the lock."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)
        self._lock.release()


def _owner(path: Path) -> str:
    """Description of the owner."""
    try:
        found = json.loads(path.read_bytes())
        return f"process {int(found['process'])} on {str(found['machine'])[:60]}"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"
