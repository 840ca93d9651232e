"""Saved states of a run as they come, in memory or in a folder on disk, where a long run has more than memory holds.

On disk a state's numbers are appended to one file for each array, and the number of states that are whole is written
last: what a killed process leaves is good up to there.
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

#: Holds how many states are whole, and what is needed to make a solution of them.
COUNT, ABOUT = "count", "run.json"
#: States that are taken at once where all would be too many.
BLOCK = 4096
#: Rows that are far apart taken at once.
ROWS = 50


def release_pages(arrays: Iterable[Any]) -> None:
    """Let the pages of arrays that are mapped from files go; they come back as they are asked for."""
    for array in arrays:
        mapped = getattr(array, "_mmap", None)
        if mapped is not None and hasattr(mmap, "MADV_DONTNEED"):
            mapped.madvise(mmap.MADV_DONTNEED)


def take_every(array: np.ndarray, every: int) -> np.ndarray:
    """Every so many rows, in memory: of a mapped file the system maps whole stretches around each row."""
    found = np.empty_like(array[::every], subok=False)
    for begin in range(0, len(found), ROWS):
        found[begin : begin + ROWS] = array[begin * every : (begin + ROWS) * every : every]
        release_pages([array])
    return found


class InMemory:
    """Rows (k, ...) of several arrays, kept as they are."""

    def __init__(self) -> None:
        self.pieces: list[Any] = []
        self.count = 0

    def append(self, piece: Any) -> None:
        """Further rows: a tree of arrays."""
        self.pieces.append(piece)
        self.count += len(jax.tree.leaves(piece)[0])

    def concatenate(self, most: int) -> Any:
        """The first rows, at most `most`."""
        return jax.tree.map(lambda *parts: np.concatenate(parts)[:most], *self.pieces)

    def join(self, first: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """Rows behind a first one."""
        return np.concatenate([np.asarray(first)[None], rest])

    def empty(self, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        """An array to be filled."""
        return np.empty(shape, dtype)


class OnDisk(InMemory):
    """The same in files of a folder."""

    def __init__(self, folder: Path, about: dict[str, Any] | None = None) -> None:
        super().__init__()
        self.folder, self._kinds, self._tree = folder, [], None
        self._numbers, self._about = itertools.count(), about or {}

    @classmethod
    def reopen(cls, folder: Path, tree: Any) -> OnDisk:
        """What a killed run left there.

        Args:
            tree: of the arrays, whatever its leaves.
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
        for begin in range(0, len(rest), BLOCK):
            found[begin + 1 : begin + 1 + BLOCK] = rest[begin : begin + BLOCK]
            release_pages((found, rest))  # else both stand in memory whole
        return found

    def empty(self, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        if 0 in shape:
            return np.zeros(shape, dtype)
        path = self.folder / f"array.{next(self._numbers)}"
        try:
            with open(path, "wb") as file:  # reserved: a disk that is full while pages go out ends the process
                os.posix_fallocate(file.fileno(), 0, int(np.prod(shape)) * np.dtype(dtype).itemsize)
        except (OSError, AttributeError):
            return np.empty(shape, dtype)
        return np.memmap(path, dtype, "r+", shape=shape)


def _write(file: BinaryIO, data: bytes) -> None:
    """All bytes: a disk that is nearly full takes some and says nothing."""
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]


def count_rows(folder: Path) -> int:
    """How many states a folder has whole."""
    try:
        return struct.unpack("<q", (folder / COUNT).read_bytes())[0]
    except (OSError, struct.error):
        return 0
