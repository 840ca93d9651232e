"""Saved states of a run, in memory or, for runs larger than memory, in a folder on disk, and the state to continue.

On disk states are appended to one file for each array. Their number and the state from which the run continues are
written last, by rename: the files of a killed process are valid up to this number.

Plain files rather than HDF5 or Zarr, which are optional packages: all three lost nothing in 60 kills during appends
of 0.6 MB. An append took 1.9, 0.6 and 4.9 ms, the import 0, 0.03 and 0.2 s, and all had the size of the numbers. HDF5
ends the process on a full disk, and runs saved as `.npz` need neither package.
"""

from __future__ import annotations

import itertools
import json
import mmap
import os
import struct
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax import Array

from dropper_jax.base.read import Table
from dropper_jax.base.store import Store, read_archive, write_archive

#: File with the number of complete states and the last one; file with what is needed to build a solution from them.
MARK = "complete.npz"
ABOUT = "run.npz"
#: Number of states processed at once if all would be too many, and of distant rows of a file read at once.
BLOCK_STATES = 4096
DISTANT_ROWS = 50
#: Rows of a run (k, ...), of JAX in a chunk, of NumPy in a store.
Rows = Array | np.ndarray


def release_pages(arrays: Iterable[Any]) -> None:
    """Release the pages of arrays that are mapped from files; they are read again on access."""
    for array in arrays:
        mapped = getattr(array, "_mmap", None)
        if mapped is not None and hasattr(mmap, "MADV_DONTNEED"):
            mapped.madvise(mmap.MADV_DONTNEED)


def take_every(array: np.ndarray, every: int) -> np.ndarray:
    """Every `every`-th row, in memory: for a mapped file the system maps long stretches around each row."""
    found = np.empty_like(array[::every], subok=False)
    for begin in range(0, len(found), DISTANT_ROWS):
        end = begin + DISTANT_ROWS
        found[begin:end] = array[begin * every : end * every : every]
        release_pages([array])
    return found


class InMemory(Store):
    """Rows (k, ...) of several arrays in memory: chunks of a run under the number of rows before them."""

    def __init__(self) -> None:
        self.path = Path("memory")
        self.chunks: list[Any] = []
        self.count = 0

    def has(self, key: int) -> bool:
        return key < self.count

    def write(self, key: int, found: tuple[Any, dict[str, np.ndarray]]) -> None:
        """Append rows, a tree of arrays, with the named leaves of the state after them."""
        self.chunks.append(found[0])
        self.count = key + len(jax.tree.leaves(found[0])[0])

    def read(self, key: int) -> Any:
        """The first `key` rows, or as many as there are."""
        return jax.tree.map(lambda *parts: np.concatenate(parts)[:key], *self.chunks)

    def join(self, first: Rows, rest: Rows) -> np.ndarray:
        """Rows after a first one."""
        return np.concatenate([np.asarray(first)[None], rest])

    def empty(self, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        """An array to be filled."""
        return np.empty(shape, dtype)


class OnDisk(InMemory):
    """Rows of several arrays in files of a folder.

    Args:
        about: plain values that identify the run; first: named leaves of its start.
    """

    def __init__(self, folder: Path, about: Table, first: dict[str, np.ndarray]) -> None:
        super().__init__()
        self.path = folder
        self.about = about
        self.first = first
        self.last: dict[str, np.ndarray] = {}
        self._kinds: list[tuple[tuple[int, ...], np.dtype]] = []  # shape and type of a row of each file
        self._tree: Any = None
        self._numbers = itertools.count()

    @classmethod
    def resume(cls, folder: Path) -> OnDisk:
        """The rows that a killed run left there; `with_structure` is needed to read them."""
        if (folder / ABOUT).exists():
            found = cls(folder, *read_archive(folder / ABOUT))
        else:  # by an earlier version
            found = cls(folder, json.loads((folder / "run.json").read_text(encoding="utf-8")), {})
        found.count, found.last = read_mark(folder)
        found._kinds = [(tuple(shape), np.dtype(kind)) for shape, kind in found.about["kinds"]]
        return found

    def with_structure(self, tree: Any) -> OnDisk:
        """The same rows, as trees like this one."""
        self._tree = jax.tree.structure(tree)
        return self

    def write(self, key: int, found: tuple[Any, dict[str, np.ndarray]]) -> None:
        leaves, tree = jax.tree.flatten(found[0])
        if self._tree is None:
            self._tree = tree
            self._kinds = [(leaf.shape[1:], leaf.dtype) for leaf in leaves]
            kinds = [[list(shape), kind.str] for shape, kind in self._kinds]
            write_archive(self.path / ABOUT, self.first, {**self.about, "kinds": kinds}, sync=False)
        for number, leaf in enumerate(leaves):
            # buffered: a disk that is nearly full takes only some bytes of an unbuffered write, silently
            with open(self.path / f"rows.{number}", "ab") as file:
                file.truncate(key * leaf[:1].nbytes)  # without what a failed write left
                file.write(leaf.tobytes())
        self.count = key + len(leaves[0])
        write_archive(self.path / MARK, {**found[1], "count": np.array(self.count)}, sync=False)

    def read(self, key: int) -> Any:
        count = min(self.count, key)
        return jax.tree.unflatten(self._tree, [self._file_rows(i, count, *kind) for i, kind in enumerate(self._kinds)])

    def _file_rows(self, number: int, count: int, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        """The first rows (count, ...) of a file, mapped."""
        if 0 in shape:
            return np.zeros((count, *shape), dtype)
        return np.memmap(self.path / f"rows.{number}", dtype, "r", shape=(count, *shape))

    def join(self, first: Rows, rest: Rows) -> np.ndarray:
        found = self.empty((len(rest) + 1, *rest.shape[1:]), rest.dtype)
        found[0] = first
        for begin in range(0, len(rest), BLOCK_STATES):
            found[begin + 1 : begin + 1 + BLOCK_STATES] = rest[begin : begin + BLOCK_STATES]
            release_pages((found, rest))  # otherwise both are completely in memory
        return found

    def empty(self, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        if 0 in shape:
            return np.zeros(shape, dtype)
        path = self.path / f"array.{next(self._numbers)}"
        try:
            with open(path, "wb") as file:  # reserved: a disk that is full when pages are written ends the process
                os.posix_fallocate(file.fileno(), 0, int(np.prod(shape)) * np.dtype(dtype).itemsize)
        except (OSError, AttributeError):
            return np.empty(shape, dtype)
        return np.memmap(path, dtype, "r+", shape=shape)


def read_mark(folder: Path) -> tuple[int, dict[str, np.ndarray]]:
    """Number of complete states in a folder, and named leaves of the last one (none by an earlier version)."""
    with suppress(Exception):  # any error about a missing or damaged file
        last = read_archive(folder / MARK)[1]
        return int(last.pop("count")), last
    with suppress(OSError, struct.error):
        return struct.unpack("<q", (folder / "count").read_bytes())[0], {}
    return 0, {}
