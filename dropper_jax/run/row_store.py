"""Store of the saved states of a run, in memory or, for runs larger than memory, in a folder on disk.

On disk states are appended to one file for each array, and the number of complete states is written last. The files of
a killed process are valid up to this number.
"""

from __future__ import annotations

import itertools
import json
import mmap
import os
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

import jax
import numpy as np

#: File with the number of complete states and the data needed to build a solution from them.
COUNT, ABOUT = "count", "run.json"
#: Number of states processed at once if all would be too many.
BLOCK_STATES = 4096


def release_pages(arrays: Iterable[Any]) -> None:
    """Release the pages of arrays that are mapped from files; they are read again on access."""
    for array in arrays:
        mapped = getattr(array, "_mmap", None)
        if mapped is not None and hasattr(mmap, "MADV_DONTNEED"):
            mapped.madvise(mmap.MADV_DONTNEED)


def take_every(array: np.ndarray, every: int) -> np.ndarray:
    """Every `step`-th row, in memory: for a mapped file the system maps long stretches around each row."""
    rows = 50  # number of distant rows read at once
    found = np.empty_like(array[::every], subok=False)
    for begin in range(0, len(found), rows):
        found[begin : begin + rows] = array[begin * every : (begin + rows) * every : every]
        release_pages([array])
    return found


class InMemory:
    """Rows (k, ...) of several arrays in memory."""

    def __init__(self) -> None:
        self.pieces: list[Any] = []
        self.count = 0

    def append(self, piece: Any) -> None:
        """Append rows: a tree of arrays."""
        self.pieces.append(piece)
        self.count += len(jax.tree.leaves(piece)[0])

    def concatenate(self, most: int) -> Any:
        """The first rows, at most `most`."""
        return jax.tree.map(lambda *parts: np.concatenate(parts)[:most], *self.pieces)

    def join(self, first: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """Rows after a first one."""
        return np.concatenate([np.asarray(first)[None], rest])

    def empty(self, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        """An array to be filled."""
        return np.empty(shape, dtype)


class OnDisk(InMemory):
    """Rows of several arrays in files of a folder."""

    def __init__(self, folder: Path, about: dict[str, Any] | None = None) -> None:
        super().__init__()
        self.folder, self._kinds, self._tree = folder, [], None
        self._numbers, self._about = itertools.count(), about or {}

    @classmethod
    def reopen(cls, folder: Path, tree: Any) -> OnDisk:
        """The rows that a killed run left there.

        Args:
            tree: structure of the arrays, with any leaves.
        """
        found = cls(folder, json.loads((folder / ABOUT).read_text(encoding="utf-8")))
        found._tree, found.count = jax.tree.structure(tree), count_rows(folder)
        found._kinds = [(tuple(shape), np.dtype(kind)) for shape, kind in found._about["kinds"]]
        return found

    def append(self, piece: Any) -> None:
        leaves, tree = jax.tree.flatten(piece)
        if self._tree is None:
            self._tree = tree
            self._kinds = [(leaf.shape[1:], leaf.dtype) for leaf in leaves]
            kinds = [[list(shape), kind.str] for shape, kind in self._kinds]
            (self.folder / ABOUT).write_text(json.dumps({**self._about, "kinds": kinds}), encoding="utf-8")
        for number, leaf in enumerate(leaves):
            with open(self.folder / f"rows.{number}", "ab", buffering=0) as file:
                _write(file, np.ascontiguousarray(leaf).tobytes())
        self.count += len(leaves[0])
        (self.folder / COUNT).write_bytes(struct.pack("<q", self.count))

    def concatenate(self, most: int) -> Any:
        count = min(self.count, most)
        found = [self._row(i, count, *kind) for i, kind in enumerate(self._kinds)]
        return jax.tree.unflatten(self._tree, found)

    def _row(self, number: int, count: int, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        if 0 in shape:
            return np.zeros((count, *shape), dtype)
        return np.memmap(self.folder / f"rows.{number}", dtype, "r", shape=(count, *shape))

    def join(self, first: np.ndarray, rest: np.ndarray) -> np.ndarray:
        first = np.asarray(first)
        found = self.empty((len(rest) + 1, *rest.shape[1:]), rest.dtype)
        found[0] = first
        for begin in range(0, len(rest), BLOCK_STATES):
            found[begin + 1 : begin + 1 + BLOCK_STATES] = rest[begin : begin + BLOCK_STATES]
            release_pages((found, rest))  # otherwise both are completely in memory
        return found

    def empty(self, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        if 0 in shape:
            return np.zeros(shape, dtype)
        path = self.folder / f"array.{next(self._numbers)}"
        try:
            with open(path, "wb") as file:  # reserved: a disk that is full when pages are written ends the process
                os.posix_fallocate(file.fileno(), 0, int(np.prod(shape)) * np.dtype(dtype).itemsize)
        except (OSError, AttributeError):
            return np.empty(shape, dtype)
        return np.memmap(path, dtype, "r+", shape=shape)


def _write(file: BinaryIO, data: bytes) -> None:
    """Write all bytes: a disk that is nearly full silently writes only some of them."""
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]


def count_rows(folder: Path) -> int:
    """Number of complete states in a folder."""
    try:
        return struct.unpack("<q", (folder / COUNT).read_bytes())[0]
    except (OSError, struct.error):
        return 0
