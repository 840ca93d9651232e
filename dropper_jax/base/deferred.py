"""A file for HDF5, which ends the process if a write fails while it closes a file, as on a full disk.

The file accepts every write. The caller looks at `refused` after closing, and raises the error of the disk itself.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from typing import BinaryIO

#: Number of bytes between two calls of `release`.
RELEASE_BYTES = 16_000_000
#: Larger writes [bytes] are data, which are not read back after a disk error (they would read as zeros); smaller ones,
#: which HDF5 reads again, are stored in memory.
SMALL_WRITE = 65_536


class DeferredErrorFile(io.RawIOBase):
    """An open file that accepts all writes; after a disk error small writes are stored in memory.

    Args:
        release: called after every `RELEASE_BYTES` bytes, to free what has been written.

    Attributes:
        refused: the error of the disk; None if there was none.
    """

    def __init__(self, file: BinaryIO, release: Callable[[], None]) -> None:
        file.flush()
        self._file = file.fileno()
        self._position = 0
        self._size = 0
        self._release = release
        self._unreleased = 0  # bytes written since the last call of `release`
        self._pending: list[tuple[int, bytes]] = []
        self.refused: OSError | None = None

    def write(self, data: bytes) -> int:
        left = memoryview(data).cast("B")
        at = self._position
        size = len(left)
        try:
            while left and self.refused is None:
                wrote = os.pwrite(self._file, left, at)
                left = left[wrote:]
                at += wrote
        except OSError as error:
            self.refused = error
        if left and len(left) <= SMALL_WRITE:
            self._pending.append((at, bytes(left)))
        self._position += size
        self._size = max(self._size, self._position)
        self._unreleased += size
        if self._unreleased > RELEASE_BYTES:
            self._release()
            self._unreleased = 0
        return size

    def readinto(self, buffer: bytearray) -> int:
        view = memoryview(buffer).cast("B")
        count = max(min(len(view), self._size - self._position), 0)
        view[:count] = os.pread(self._file, count, self._position).ljust(count, b"\0")
        for at, data in self._pending:
            first = max(at, self._position)
            last = min(at + len(data), self._position + count)
            if first < last:
                view[first - self._position : last - self._position] = data[first - at : last - at]
        self._position += count
        return count

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._position = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}[whence]
        return self._position

    def truncate(self, size: int | None = None) -> int:
        if size is None:
            size = self._position
        self._size = size
        if self.refused is None:
            try:
                os.ftruncate(self._file, self._size)
            except OSError as error:
                self.refused = error
        return self._size

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True
