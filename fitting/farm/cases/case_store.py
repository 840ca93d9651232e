"""Runs of load cases on disk: one file each, written atomically, with a name derived from all of its inputs.

The name identifies a run that is requested again, after a stop or together with new sea states, seeds or states.
Factors, capacities and anchors are not part of it: they may change without a new run.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.base.store import Store, StoreStopped, read_archive, write_archive
from dropper_jax.scene import whole_lines
from fitting.farm.cases.case_run import STATUS
from fitting.farm.cases.run_arrays import RunArrays
from fitting.farm.site import Case, Site, Storm
from fitting.sweep.effect_files import effect_digests

#: Increased when older files can no longer be used.
RUN_FORMAT = 2
#: The folder of the runs, and the number of hexadecimal digits in the name of a file.
RUNS = "runs"
NAME_LENGTH = 20


class CasesStopped(StoreStopped):
    """Runs that had to stop (full disk, dead worker); finished runs are complete, and the same call resumes."""


class CaseStore(Store[Case, RunArrays]):
    """The folder of a site's runs with one step: a file for each, whose name is the mark and the key of its inputs.

    Attributes:
        links: by name of a line, which of all links are its own.

    Raises:
        SceneError: the folder cannot be made, or is a file.
    """

    stopped = CasesStopped

    def __init__(self, folder: str | Path, site: Site) -> None:
        self.path = Path(folder) / RUNS
        self.site = site
        self.links = {line.name: line.links for line in whole_lines(site.scene)}
        self._shared = _digest(json.dumps(_shared_inputs(site), sort_keys=True))
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SceneError(f"--out: {str(folder)!r} cannot be made: {error.strerror or error}") from None

    def file(self, case: Case) -> Path:
        """The file of a run."""
        storm = case.storm
        broken = None
        if storm.broken is not None:
            broken = [storm.broken.line, storm.broken.link, self.site.break_time]
        own = {
            "changes": self.site.still_changes(storm),
            "waves": storm.sea_state.waves(storm.direction, case.seed),
            "broken": broken,
        }
        name = _digest(self._shared + json.dumps(own, sort_keys=True))[:NAME_LENGTH]
        return self.path / f"{name}.npz"

    def has(self, key: Case) -> bool:
        return self.read(key) is not None

    def read(self, key: Case) -> RunArrays | None:
        try:
            return read_archive(self.file(key))[1]
        except Exception:  # any error about damaged bytes: such a file is computed again
            return None

    def write(self, key: Case, found: RunArrays) -> None:
        write_archive(self.file(key), found)

    def runs_of(self, storm: Storm, seeds: Sequence[int] | None = None) -> tuple[list[RunArrays], list[Table]]:
        """Runs of a load case that ended well, and a row for every other one.

        Args:
            seeds: default: all of the site.

        Returns:
            the arrays of the former, and {case, seed, status, time_s: of the failed step, why} of the latter.
        """
        good = []
        bad = []
        for seed in self.site.seeds if seeds is None else seeds:
            found = self.read(Case(storm, seed)) or {}
            status = STATUS[int(found["status"])] if found else "missing"
            if status == "ok":
                good.append(found)
                continue
            at = float(found["failed_at"]) if "failed_at" in found else None
            why = str(found.get("message", ""))
            bad.append({"case": storm.number, "seed": seed, "status": status, "time_s": at, "why": why})
        return good, bad

    def maxima(self, runs: Sequence[RunArrays], line: str) -> np.ndarray:
        """Maximum tension (runs,) [N] of a line."""
        return np.array([run["largest"][self.links[line]].max() for run in runs])


def _shared_inputs(site: Site) -> Table:
    """The inputs that all runs of a site share, as plain values."""
    run = site.run
    shared = {
        "format": RUN_FORMAT,
        "scene": site.scene.as_written(),
        "run": [run.duration, site.steps.get("dt", site.steps), run.skip, run.ramp],
        "exclusion": site.exclusion is not None,
        "curved": site.curve_lines,
    }
    # only where there are any: earlier versions, which lacked these, gave the other runs the same names
    if site.quantities:
        shared["quantities"] = site.quantities
    if site.scene.failures:  # their breaks were stored as those of a state
        shared["failures"] = len(site.scene.failures)
    if effects := effect_digests(site.scene):
        shared["effects"] = effects
    return shared


def _digest(text: str) -> str:
    """SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()
