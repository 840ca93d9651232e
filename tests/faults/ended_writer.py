"""Appends chunks to a store until it is ended: `ended_writer.py KIND FOLDER COUNT`, a JSON line after each writer.

Each writer is a fork that a `SIGKILL` ends at a random moment; the last one may write no file above 30 bytes, as on a
full disk. What it left is read by another fork: Zarr has threads, which a fork does not inherit.
"""

import json
import os
import random
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.base.store import Store
from dropper_jax.run.row_store import OnDisk
from fitting.farm.cases.case_store import CaseStore
from fitting.sweep.make_plan import make_plan
from fitting.sweep.store import SweepStore

#: More chunks than sixty writers append in 20 ms each; rows of a chunk.
CHUNKS, ROWS = {"run": 4000, "cases": 1000, "sweep": 400}, 5
TENSIONS = ("tension_max", "tension_mean", "tension_min")
VERSIONS = dict.fromkeys(("jax", "jaxlib", "dropper-jax"), "1")


class Cases(CaseStore):
    """Load cases by number."""

    def __init__(self, folder: Path) -> None:
        self.path = folder
        folder.mkdir(exist_ok=True)

    def file(self, case: int) -> Path:
        return self.path / f"{case}.npz"


def store_of(kind: str) -> Callable[[Path], Store]:
    """What creates or resumes the store in a folder."""
    if kind == "cases":
        return Cases
    if kind == "sweep":
        plan = make_plan("conical-pendulum", {"line.0.mass": np.linspace(1, 2, CHUNKS[kind] * ROWS)}, chunk=ROWS)
        assert len(plan.base) == 2  # computed here: a fork of JAX must not compute
        return lambda folder: SweepStore(folder, plan, VERSIONS)

    def rows(folder: Path) -> OnDisk:
        folder.mkdir(exist_ok=True)
        return OnDisk.resume(folder) if (folder / "run.npz").exists() else OnDisk(folder, {}, {"start": np.zeros(3)})

    return rows


def chunk(kind: str, key: int) -> Any:
    """The content of a chunk, which follows from its number."""
    numbers = np.random.default_rng(key).normal(size=(ROWS, 200))
    if kind == "run":
        return [numbers], {"end": numbers[-1]}
    if kind == "cases":
        return {"largest": numbers}
    found = dict.fromkeys(("energy_final", "excursion", "failed_at", *TENSIONS), numbers[:, 0])
    return {**found, "angle_max": numbers[:, :1], "status": np.zeros(ROWS, np.int8)}


def is_right(kind: str, store: Store, key: int) -> bool:
    """Whether a chunk has its own numbers."""
    right = chunk(kind, key)
    if kind == "run":
        (found,) = store.with_structure([0.0]).read(key + ROWS)
        return np.array_equal(found[key:], right[0][0])
    found = store.read(key)
    return all(np.array_equal(found[name], right[name]) for name in right)


def append_all(kind: str, store: Store, keys: list[int], log: Path, limit: int) -> None:
    """Append the missing chunks, and note each one that is complete."""
    with log.open("a") as noted:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
        for key in [key for key in keys if not store.has(key)]:
            store.append(key, chunk(kind, key))
            noted.write(f"{key}\n")
            noted.flush()


def check(kind: str, store: Store, keys: list[int], noted: list[int]) -> None:
    """Print noted chunks that are lost, the number of complete ones, and those with wrong numbers."""
    done = [key for key in keys if store.has(key)]
    wrong = [key for key in done[-4:] if not is_right(kind, store, key)]
    if kind == "run" and done and not np.array_equal(store.last["end"], chunk(kind, done[-1])[1]["end"]):
        wrong.append(-1)
    print(json.dumps({"lost": sorted(set(noted) - set(done)), "done": len(done), "wrong": wrong}), flush=True)


def forked(work: Callable[[], None]) -> int:
    """The process that does this work, and prints the error that ends it; any but a full disk is its exit status."""
    process = os.fork()
    if not process:
        status = 1
        try:
            work()
            status = 0
        except OSError as error:
            print(json.dumps({"refused": str(error)}), flush=True)
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)
    return process


def wait(process: int) -> None:
    """The end of a process, which may have been killed."""
    status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    if status not in (0, -signal.SIGKILL):
        sys.exit(status)


def main(kind: str, folder: Path, count: int) -> None:
    rng, store, log = random.Random(kind), store_of(kind), folder / "log"
    keys = [key * ROWS if kind == "run" else key for key in range(CHUNKS[kind])]
    log.touch()
    for number in range(count + 1):
        limit = resource.RLIM_INFINITY if number < count else 30
        before, late = log.stat().st_size, time.monotonic() + 30
        process = forked(lambda limit=limit: append_all(kind, store(folder / "store"), keys, log, limit))
        if number < count:
            # a quarter of the moments lies in the creation
            while number > count // 4 and time.monotonic() < late and log.stat().st_size == before:
                time.sleep(0.001)
            time.sleep(rng.uniform(0.0, 0.02))
            os.kill(process, signal.SIGKILL)
        wait(process)
        noted = [int(line) for line in log.read_text().split()]
        wait(forked(lambda noted=noted: check(kind, store(folder / "store"), keys, noted)))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))
