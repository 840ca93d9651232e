"""Appends chunks to a store until it is ended: `ended_writer.py KIND FOLDER SEED COUNT`, a JSON line per ended writer.

Each writer is a fork that a `SIGKILL` ends at a random moment, or whose files are limited in size as by a full disk.
What it left is read by another fork: Zarr has threads, which a fork does not inherit.
"""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.base.files import PART
from dropper_jax.base.store import Store
from dropper_jax.run.row_store import OnDisk
from fitting.cases.run import CaseStore
from fitting.sweep.store import SweepStore

CHUNKS, ROWS = 400, 5


class Plan:
    """What a sweep's store asks of a plan: cases of a chunk, shapes, identity."""

    cases, chunk, chunks, axes, traces = CHUNKS * ROWS, ROWS, CHUNKS, (), False
    named_quantities, quantities = (), ()

    def cases_of(self, chunk: int) -> np.ndarray:
        return np.arange(chunk * ROWS, (chunk + 1) * ROWS)

    def inputs(self, cases: np.ndarray) -> np.ndarray:
        return np.zeros((len(cases), 0))

    def identity(self) -> dict[str, Any]:
        return {"format": 1}


class Rows(OnDisk):
    """Rows of a run; a chunk is read as its rows and its end."""

    def read(self, key: int) -> Any:
        self.with_structure([0.0, 0.0])
        start = key * ROWS
        return [part[start : start + ROWS] for part in super().read(start + ROWS)], self.last

    def has(self, key: int) -> bool:
        return super().has(key * ROWS)

    def write(self, key: int, found: Any) -> None:
        super().write(key * ROWS, found)


class Sweep(SweepStore):
    """A sweep of two quantities."""

    def _variables(self) -> dict[str, tuple[Any, ...]]:
        return {name: ((200,), ("link",), "N", name) for name in ("tension", "slack")}

    def _create(self, group: Any, versions: dict[str, str]) -> None:
        self.plan.scene = type("Scene", (), {"run": type("Run", (), {"dtype": "float64"})})
        super()._create(group, versions)


class Cases(CaseStore):
    """Load cases by number."""

    def __init__(self, folder: Path) -> None:
        self.path = folder
        folder.mkdir(exist_ok=True)

    def file(self, case: int) -> Path:
        return self.path / f"{case}.npz"


def opened(kind: str, folder: Path) -> Store:
    """The store: created, or resumed."""
    if kind == "sweep":
        return Sweep(folder, Plan(), dict.fromkeys(("jax", "jaxlib", "dropper-jax"), "1"))
    if kind == "cases":
        return Cases(folder)
    folder.mkdir(exist_ok=True)
    return Rows.resume(folder) if (folder / "run.npz").exists() else Rows(folder, {}, {"start": np.zeros(3)})


def chunk(kind: str, key: int) -> Any:
    """The content of a chunk, which follows from its number."""
    numbers = np.random.default_rng(key).normal(size=(2, ROWS, 200))
    if kind == "run":
        return list(numbers), {"end": numbers[0, -1]}
    arrays = dict(zip(("tension", "slack"), numbers, strict=True))
    return arrays | {"status": np.zeros(ROWS, np.int8), "failed_at": np.zeros(ROWS)} if kind == "sweep" else arrays


def forked(work: Callable[[], None]) -> int:
    """The process that does this work."""
    process = os.fork()
    if not process:
        try:
            work()
        finally:
            os._exit(0)
    return process


def append_all(kind: str, folder: Path, log: Path, limit: int | None) -> None:
    """Append the missing chunks, and note each one that is complete."""
    store, (usual, most) = opened(kind, folder), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (usual if limit is None else limit, most))
    with log.open("a") as noted:
        for key in [key for key in range(CHUNKS) if not store.has(key)]:
            try:
                store.append(key, chunk(kind, key))
            except OSError as error:
                resource.setrlimit(resource.RLIMIT_FSIZE, (usual, most))
                (log.parent / "refused").write_text(str(error))
                return
            noted.write(f"{key}\n")
            noted.flush()


def check(kind: str, folder: Path, log: Path, answer: Path) -> None:
    """Noted chunks that are lost, complete ones, wrong numbers, and leftovers of killed writers."""
    store, noted = opened(kind, folder), [int(line) for line in log.read_text().split()] if log.exists() else []
    done = [key for key in range(CHUNKS) if store.has(key)]
    wrong = []
    for key in done[-4:]:
        found, right = store.read(key), chunk(kind, key)
        pairs = zip(found[0], right[0], strict=True) if kind == "run" else ((found[n], right[n]) for n in right)
        if not all(np.array_equal(a, b) for a, b in pairs):
            wrong.append(key)
    if kind == "run" and done and not np.array_equal(store.last["end"], chunk(kind, done[-1])[1]["end"]):
        wrong.append(-1)
    told = {"lost": sorted(set(noted) - set(done)), "done": len(done), "noted": len(noted), "wrong": wrong}
    answer.write_text(json.dumps(told))


def size(file: Path) -> int:
    """Bytes of a file, 0 without one."""
    return file.stat().st_size if file.exists() else 0


def main(kind: str, folder: Path, seed: str, count: int) -> None:
    rng = random.Random(f"{kind} {seed}")
    store, log, answer = folder / "store", folder / "log", folder / "answer.json"
    for number in range(count):
        limit = None if number < count - 1 else 4_000  # the last one is refused by a full disk instead
        process = forked(lambda limit=limit: append_all(kind, store, log, limit))
        if limit is None:
            before, late = size(log), time.monotonic() + 30
            # a quarter of the moments lies in the creation
            while number > count // 4 and time.monotonic() < late and size(log) == before:
                time.sleep(0.001)
            time.sleep(rng.uniform(0.0, 0.05))
            os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        os.waitpid(forked(lambda: check(kind, store, log, answer)), 0)
        print(answer.read_text(), flush=True)
    left = [str(item) for item in folder.rglob(f"*{PART}")]
    print(json.dumps({"left": left, "refused": (folder / "refused").read_text()}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), sys.argv[3], int(sys.argv[4]))
