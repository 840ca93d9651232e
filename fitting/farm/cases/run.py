"""All runs of a site: on the cores of this machine, or on the workers of a Dask cluster; resumable."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import threading
import time
import zipfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.base.store import Store, StoreStopped, read_archive, write_archive
from dropper_jax.effects import REGISTERED_FILES, register_file, register_installed
from fitting.farm.cases.one import Found, Runner
from fitting.farm.site import Case, Site, read_site
from fitting.sweep.run import done_on

# Runs of load cases on disk: one file each, written atomically, with a name derived from all of its inputs.
#
# The name identifies a run that is requested again, after a stop or together with new sea states, seeds or states.
# Factors, capacities and anchors are not part of it: they may change without a new run.

#: Increased when older files can no longer be used.
RUN_FORMAT = 2
RUNS = "runs"


class CasesStopped(StoreStopped):
    """Runs that had to stop (full disk, dead worker); finished runs are complete, and the same call resumes."""


class CaseStore(Store[Case, Found]):
    """The folder of a site's runs with one step: a file for each, whose name is the mark and the key of its inputs.

    Raises:
        SceneError: the folder cannot be made, or is a file.
    """

    stopped = CasesStopped

    def __init__(self, folder: str | Path, site: Site, dt: float) -> None:
        self.path, self.site = Path(folder) / RUNS, site
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SceneError(f"--out: {str(folder)!r} cannot be made: {error.strerror or error}") from None
        run = site.run
        shared = {
            "format": RUN_FORMAT,
            "scene": site.scene.as_written(),
            "run": [run.duration, dt, run.skip, run.ramp],
            "exclusion": site.exclusion is not None,
            "curved": site.curve_lines,
            **({"quantities": site.quantities} if site.quantities else {}),
        }
        self._shared = hashlib.sha256(json.dumps(shared, sort_keys=True).encode()).hexdigest()

    def file(self, case: Case) -> Path:
        """The file of a run."""
        storm = case.storm
        own = {
            "changes": self.site.still_changes(storm),
            "waves": storm.sea_state.waves(storm.direction, case.seed),
            "broken": None if storm.broken is None else [storm.broken.line, storm.broken.link, self.site.break_time],
        }
        text = self._shared + json.dumps(own, sort_keys=True)
        return self.path / f"{hashlib.sha256(text.encode()).hexdigest()[:20]}.npz"

    def has(self, key: Case) -> bool:
        return zipfile.is_zipfile(self.file(key))

    def read(self, key: Case) -> Found | None:
        try:
            return read_archive(self.file(key))[1]
        except Exception:  # any error about damaged bytes: such a file is computed again
            return None

    def write(self, key: Case, found: Found) -> None:
        write_archive(self.file(key), found)


@dataclasses.dataclass(frozen=True)
class Done:
    """Result of a call: total number of runs, those found in the folder, wall time [s] of the others."""

    runs: int
    resumed: int
    run_s: float


def run_cases(
    site: Site,
    folder: str | Path,
    *,
    cases: Sequence[Case] | None = None,
    dt: float | None = None,
    workers: int = 1,
    scheduler: Any = None,
    progress: Progress | None = None,
) -> Done:
    """Run all cases that are not stored yet.

    Args:
        folder: stores the runs, one file each; after a kill at any moment, the same call resumes.
        cases: default: all of the site; dt: step [s], default: the site's.
        workers: processes of this machine, each with one compiled program.
        scheduler: a Dask client or the address of a scheduler, whose workers run the cases.

    Raises:
        CasesStopped: writing failed or a worker died; finished runs are kept.
    """
    cases = list(site.cases if cases is None else cases)
    dt = site.prepared().run.step if dt is None else dt
    store = CaseStore(folder, site, dt)
    todo = [case for case in cases if not store.has(case)]
    kept = len(cases) - len(todo)
    started = time.perf_counter()
    if scheduler is not None:
        source = _remote(site, todo, dt, scheduler)
    elif workers > 1 and len(todo) > 1:
        source = _local(site, todo, dt, min(workers, len(todo)))
    else:
        source = _here(site, todo, dt)

    def words(ran: int, seconds: float) -> str:
        return f"{kept + ran} of {len(cases)} runs, {seconds / ran * (len(todo) - ran):.0f} s left"

    store.fill(source, kept, len(cases), progress or silent, words)
    return Done(len(cases), kept, time.perf_counter() - started)


def _here(site: Site, todo: list[Case], dt: float) -> Iterator[tuple[Case, Found]]:
    if todo:
        runner = Runner(site, dt)
        yield from ((case, runner(case)) for case in todo)


@lru_cache(maxsize=2)
def _runner(identity: str, dt: float) -> Runner:
    """The runner shared by all runs of a worker."""
    register_installed()
    return Runner(read_site(json.loads(identity)), dt)


def run_one(identity: str, dt: float, number: int, seed: int) -> Found:
    """One run on a worker: the load case with this number, of the site with these values."""
    runner = _runner(identity, dt)
    return runner(Case(runner.site.storms[number], seed))


def _local(site: Site, todo: list[Case], dt: float, workers: int) -> Iterator[tuple[Case, Found]]:
    """Results from processes of this machine, as they finish."""
    identity = json.dumps(site.portable())
    with ProcessPoolExecutor(
        workers, mp_context=get_context("spawn"), initializer=_begin, initargs=(os.getpid(), REGISTERED_FILES)
    ) as pool:
        futures = {pool.submit(run_one, identity, dt, c.storm.number, c.seed): c for c in todo}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except RuntimeError as error:  # the pool ends when a worker dies
            raise CasesStopped(f"a worker ended: {error or type(error).__name__}; the same call resumes") from None
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _begin(parent: int, effect_files: list[str]) -> None:
    """Register the effects that the parent knows; end this process when the parent ends, for any reason."""
    for file in effect_files:
        register_file(file)

    def watch_parent() -> None:
        while os.getppid() == parent:
            time.sleep(2.0)
        os._exit(1)

    threading.Thread(target=watch_parent, daemon=True).start()


def _remote(site: Site, todo: list[Case], dt: float, scheduler: Any) -> Iterator[tuple[Case, Found]]:
    """Over a cluster."""
    identity = json.dumps(site.portable())
    jobs = [(identity, dt, case.storm.number, case.seed) for case in todo]
    return ((todo[i], found) for i, found in done_on(scheduler, run_one, jobs))
