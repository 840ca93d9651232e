"""Files of compiled programs in a folder of the user, each after its digest, with a limit on their total size.

JAX loads a file with a flipped bit without an error, and reads its part of a file by `pickle`, which can run any code.
A file is therefore read only if its digest is right, from a folder that belongs to the user and that no other user may
write, where the system knows owners.
"""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
import time
from contextlib import suppress
from pathlib import Path

#: First bytes of a file, before the digest and the program.
MARK = b"dropper2"
#: Suffix of a file until all of it is on the disk.
UNFINISHED = ".unfinished"
#: Permissions that a folder of programs must not have.
WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
#: Length [bytes] of the digest of a file.
DIGEST = hashlib.sha256().digest_size
#: Age [s] after which an unfinished file counts as left over from a stopped process.
ABANDONED_AGE = 3600.0
#: Total size [bytes] of the stored programs; the least recently used ones are removed first.
MAX_STORED_BYTES = 1_000_000_000
#: How often the sizes of all files are added up while the limit is written: it costs more than storing a file, and the
#: limit may be exceeded by 1/`LOOKS`.
LOOKS = 64


class Folder:
    """Files by key in a folder, with a limit on their total size.

    Args:
        path: the folder, which exists.
        largest: total size [bytes] of its files.
    """

    def __init__(self, path: Path, largest: int = MAX_STORED_BYTES) -> None:
        self.path = path
        self.largest = largest
        self._unseen = largest  # bytes written since the sizes of all files were added up

    def read(self, key: str) -> bytes | None:
        """The content with that key; None if it is missing or damaged. A damaged file is removed."""
        file = self.path / key
        try:
            whole = file.read_bytes()
        except OSError:
            return None
        head = whole[: len(MARK) + DIGEST]
        content = whole[len(MARK) + DIGEST :]
        if head != MARK + hashlib.sha256(content).digest():
            self.remove(key)
            return None
        with suppress(OSError):
            os.utime(file)
        return content

    def write(self, key: str, content: bytes) -> None:
        """Store content, replacing an existing file at once; a full or read-only disk is ignored."""
        with suppress(OSError):
            with tempfile.NamedTemporaryFile(dir=self.path, suffix=UNFINISHED, delete=False) as file:
                file.write(MARK + hashlib.sha256(content).digest() + content)
            os.replace(file.name, self.path / key)
            self._unseen += len(content)
            if self._unseen > self.largest / LOOKS:
                self._remove_old()
                self._unseen = 0

    def remove(self, key: str) -> None:
        """Remove a file."""
        with suppress(OSError):
            (self.path / key).unlink()

    def _remove_old(self) -> None:
        """Remove the least recently used files beyond the limit, and what stopped processes have left."""
        files = []
        for file in self.path.iterdir():
            with suppress(OSError):
                about = file.stat()
                if file.suffix != UNFINISHED:
                    files.append((about.st_mtime, about.st_size, file))
                elif about.st_mtime < time.time() - ABANDONED_AGE:
                    file.unlink()
        size = sum(bytes_ for _, bytes_, _ in files)
        for _, bytes_, file in sorted(files):
            if size <= self.largest:
                return
            self.remove(file.name)
            size -= bytes_


def open_folder(folder: Path) -> Path | None:
    """The folder of programs, created if it is missing; None if it is not the user's own, not writable, or
    writable by others."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        tempfile.TemporaryFile(dir=folder).close()
        status = folder.stat()
        if hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & WRITABLE_BY_OTHERS):
            return None
    except OSError:
        return None
    return folder


def user_folder() -> Path | None:
    """The user's folder of programs; None for a user without a home directory."""
    from platformdirs import user_cache_path  # noqa: PLC0415 - only the command line needs it

    folder = user_cache_path("dropper-jax", appauthor=False, opinion=False)
    if not folder.is_absolute():
        return None
    return folder / "programs"
