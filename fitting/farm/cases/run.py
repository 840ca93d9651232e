"""All runs of a site: on the cores of this machine, or on the workers of a Dask cluster; resumable."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from dropper_jax.base.progress import Progress, silent
from dropper_jax.effects import REGISTERED_FILES, register_file, register_installed
from fitting.farm.cases.case_run import CaseRunner
from fitting.farm.cases.case_store import CasesStopped, CaseStore
from fitting.farm.cases.run_arrays import RunArrays
from fitting.farm.site import Case, Site, read_site
from fitting.sweep.cluster import run_on_cluster


@dataclass(frozen=True)
class FinishedRuns:
    """Result of a call: total number of runs, those found in the folder, wall time [s] of the others."""

    runs: int
    resumed: int
    run_s: float


def run_cases(
    site: Site,
    folder: str | Path,
    *,
    cases: Sequence[Case] | None = None,
    workers: int = 1,
    scheduler: Any = None,
    progress: Progress | None = None,
) -> FinishedRuns:
    """Run all cases that are not stored yet.

    Args:
        folder: stores the runs, one file each; after a kill at any moment, the same call resumes.
        cases: default: all of the site.
        workers: processes of this machine, each with one compiled program.
        scheduler: a Dask client or the address of a scheduler, whose workers run the cases.

    Raises:
        CasesStopped: writing failed or a worker died; finished runs are kept.
    """
    if cases is None:
        cases = site.cases
    cases = list(cases)
    store = CaseStore(folder, site)
    todo = [case for case in cases if not store.has(case)]
    resumed = len(cases) - len(todo)
    started = time.perf_counter()
    identity = json.dumps(site.portable())
    jobs = [(identity, case.storm.number, case.seed) for case in todo]
    source: Iterable[tuple[int, RunArrays]] = ()
    if scheduler is not None:
        source = run_on_cluster(scheduler, run_one, jobs)
    elif workers > 1 and len(todo) > 1:
        source = _run_in_processes(jobs, min(workers, len(todo)))
    elif todo:
        source = enumerate(map(CaseRunner(site), todo))

    def count_and_rest(ran: int, seconds: float) -> str:
        return f"{resumed + ran} of {len(cases)} runs, {seconds / ran * (len(todo) - ran):.0f} s left"

    results = ((todo[i], found) for i, found in source)
    store.fill(results, resumed, len(cases), progress or silent, count_and_rest)
    return FinishedRuns(len(cases), resumed, time.perf_counter() - started)


@lru_cache(maxsize=2)
def _runner(identity: str) -> CaseRunner:
    """The runner shared by all runs of a worker."""
    register_installed()
    return CaseRunner(read_site(json.loads(identity)))


def run_one(identity: str, number: int, seed: int) -> RunArrays:
    """One run on a worker: the load case with this number, of the site with these values."""
    runner = _runner(identity)
    return runner(Case(runner.site.storms[number], seed))


def _run_in_processes(jobs: list[tuple[str, int, int]], workers: int) -> Iterator[tuple[int, RunArrays]]:
    """Results from processes of this machine by number of the job, as they finish."""
    with ProcessPoolExecutor(
        workers, mp_context=get_context("spawn"), initializer=_start_worker, initargs=(os.getpid(), REGISTERED_FILES)
    ) as pool:
        futures = {pool.submit(run_one, *job): i for i, job in enumerate(jobs)}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except RuntimeError as error:  # the pool ends when a worker dies
            raise CasesStopped(f"a worker ended: {error or type(error).__name__}; the same call resumes") from None
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _start_worker(parent: int, effect_files: list[str]) -> None:
    """Register the effects that the parent knows; end this process when the parent ends, for any reason."""
    for file in effect_files:
        register_file(file)

    def watch_parent() -> None:
        while os.getppid() == parent:
            time.sleep(2.0)
        os._exit(1)

    threading.Thread(target=watch_parent, daemon=True).start()
