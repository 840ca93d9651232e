"""A file that postpones the error of a full disk until HDF5 has closed it.

HDF5 ends the process if a write fails while it closes a file. This file accepts every write. The caller looks at
`refused` after closing, and raises the error of the disk itself.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from typing import BinaryIO

#: Number of bytes between two calls of `release`.
RELEASE_BYTES = 16_000_000
#: Maximum size [bytes] of a write that is kept in memory after a disk error. HDF5 reads its own tables again, which are
#: smaller. Larger writes are data, which it does not read; they are dropped.
SMALL_WRITE = 65_536


class DeferredErrorFile(io.RawIOBase):
    """An open file that accepts all writes.

    Args:
        release: called after every `RELEASE_BYTES` bytes, to free the memory of what has been written.

    Attributes:
        refused: the first error of the disk; None if there was none. Nothing is written to the disk after it.
    """

    def __init__(self, file: BinaryIO, release: Callable[[], None]) -> None:
        file.flush()
        self._file = file.fileno()
        self._position = 0
        self._size = 0
        self._release = release
        self._unreleased = 0  # bytes written since the last call of `release`
        self._in_memory: list[tuple[int, bytes]] = []  # position and bytes of small writes after an error
        self.refused: OSError | None = None

    def write(self, data: bytes) -> int:
        left = memoryview(data).cast("B")
        size = len(left)
        at = self._position
        try:
            while left and self.refused is None:
                wrote = os.pwrite(self._file, left, at)
                left = left[wrote:]
                at += wrote
        except OSError as error:
            self.refused = error
        if left and len(left) <= SMALL_WRITE:
            self._in_memory.append((at, bytes(left)))
        self._position += size
        self._size = max(self._size, self._position)
        self._unreleased += size
        if self._unreleased > RELEASE_BYTES:
            self._release()
            self._unreleased = 0
        return size

    def readinto(self, buffer: bytearray) -> int:
        """Read what was written: from the disk, then from memory in its place; dropped writes are zeros."""
        view = memoryview(buffer).cast("B")
        start = self._position
        end = max(min(start + len(view), self._size), start)
        view[: end - start] = os.pread(self._file, end - start, start).ljust(end - start, b"\0")
        for at, data in self._in_memory:
            first = max(at, start)
            last = min(at + len(data), end)
            if first < last:
                view[first - start : last - start] = data[first - at : last - at]
        self._position = end
        return end - start

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        origins = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}
        self._position = origins[whence] + offset
        return self._position

    def truncate(self, size: int | None = None) -> int:
        if size is None:
            size = self._position
        self._size = size
        try:
            if self.refused is None:
                os.ftruncate(self._file, size)
        except OSError as error:
            self.refused = error
        return size

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True
