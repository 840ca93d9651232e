"""Results of one request on disk, chunk by chunk: what runs, sweeps and load cases have in common.

A chunk counts once its mark exists, which is written last and by rename. A kill at any moment therefore loses the chunk
that is being written and no other. A full disk stops the work, and the complete chunks stay.
"""

from __future__ import annotations

import json
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from dropper_jax.base.files import atomic_write, unwritable
from dropper_jax.base.progress import Progress
from dropper_jax.base.read import Plain, join

Key = TypeVar("Key")
Found = TypeVar("Found")


class StoreStopped(RuntimeError):
    """Work that had to stop (full disk, dead worker); complete results are kept, and the same call resumes."""


class Store(ABC, Generic[Key, Found]):
    """Chunks of results, each under its key. `path` is the file or folder that errors name.

    Creating a store on an existing folder resumes it, unless it belongs to another request, by `request_differences`.
    """

    path: Path
    #: The error of this subject.
    stopped: ClassVar[type[StoreStopped]] = StoreStopped

    @abstractmethod
    def has(self, key: Key) -> bool:
        """Whether a chunk is complete."""

    @abstractmethod
    def read(self, key: Key) -> Found | None:
        """The arrays of a chunk; None if it is not complete."""

    @abstractmethod
    def write(self, key: Key, found: Found) -> None:
        """Write a chunk, its mark last."""

    def append(self, key: Key, found: Found) -> None:
        """Add a chunk.

        Raises:
            OSError: the disk cannot be written; the error names the store.
        """
        try:
            self.write(key, found)
        except OSError as error:
            raise unwritable(self.path, error) from None

    def fill(
        self,
        results: Iterable[tuple[Key, Found]],
        before: int,
        total: int,
        say: Progress,
        words: Callable[[int, float], str],
        size: Callable[[Key], int] = lambda key: 1,
    ) -> int:
        """Append results as they come, and report the fraction done; returns the number of cases that were added.

        Args:
            before, total: cases that were complete before, and all.
            words: the text of a report, from the cases added and their wall time [s].
            size: cases of a chunk.

        Raises:
            StoreStopped: the disk cannot be written.
        """
        started = time.perf_counter()
        added = 0
        for key, found in results:
            try:
                self.append(key, found)
            except OSError as error:
                raise self.stopped(
                    f"{self.path}: {error.strerror}; {before + added} of {total} cases are kept, the same call resumes"
                ) from None
            added += size(key)
            say((before + added) / total, words(added, time.perf_counter() - started))
        return added


def write_archive(path: str | Path, arrays: Mapping[str, np.ndarray], meta: Plain = None, sync: bool = True) -> Path:
    """Write arrays, and plain values as JSON under `meta`, to a compressed `.npz` file: completely or not at all.

    Raises:
        OSError: the file cannot be written; the error contains its name.
    """
    found: dict[str, Any] = {}
    if meta is not None:
        found["meta"] = np.array(json.dumps(meta))
    found |= arrays
    return atomic_write(path, lambda file: np.savez_compressed(file, **found), sync)


def read_archive(path: str | Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Plain values (empty without any) and arrays of an `.npz` file.

    Raises:
        Exception: any error of the archive, its codecs or JSON about damaged bytes.
    """
    with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
        arrays = dict(archive)
    return json.loads(str(arrays.pop("meta", "{}"))), arrays


def request_differences(here: Mapping[str, Any], there: Mapping[str, Any]) -> list[str]:
    """Paths at which two requests, as plain values, differ, with both values."""
    one = _comparable_items(here)
    other = _comparable_items(there)
    found = []
    for path in sorted({*one, *other}):
        if one.get(path) != other.get(path):
            found.append(f"{path} = {_short(other.get(path))} there, {_short(one.get(path))} here")
    return found


def _comparable_items(values: Mapping[str, Any]) -> dict[str, Plain]:
    """Leaves by path as JSON has them, with NaN as a text: a number NaN differs from itself."""
    return dict(flat_items(json.loads(json.dumps(values), parse_constant=str)))


def flat_items(value: Plain, path: str = "") -> Iterator[tuple[str, Plain]]:
    """Leaves of plain tables by path; lists of plain values are leaves."""
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        value = dict(enumerate(value))
    if not isinstance(value, dict):
        yield path, value
        return
    for key, item in value.items():
        yield from flat_items(item, join(path, str(key)))


def _short(value: Plain) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, list) and len(value) > 3:
        return f"[{value[0]}, {value[1]}, ... {value[-1]}] ({len(value)} values)"
    return str(value)
