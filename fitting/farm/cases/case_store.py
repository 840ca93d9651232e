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
from fitting.farm.cases.run_arrays import Found
from fitting.farm.site import Case, Site, Storm

#: Increased when older files can no longer be used.
RUN_FORMAT = 2
RUNS = "runs"


class CasesStopped(StoreStopped):
    """Runs that had to stop (full disk, dead worker); finished runs are complete, and the same call resumes."""


class CaseStore(Store[Case, Found]):
    """The folder of a site's runs with one step: a file for each, whose name is the mark and the key of its inputs.

    Attributes:
        links: of each line.

    Raises:
        SceneError: the folder cannot be made, or is a file.
    """

    stopped = CasesStopped

    def __init__(self, folder: str | Path, site: Site) -> None:
        self.path = Path(folder) / RUNS
        self.site = site
        self.links = {line.name: line.links for line in whole_lines(site.scene)}
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SceneError(f"--out: {str(folder)!r} cannot be made: {error.strerror or error}") from None
        run = site.run
        shared = {
            "format": RUN_FORMAT,
            "scene": site.scene.as_written(),
            "run": [run.duration, site.steps.get("dt", site.steps), run.skip, run.ramp],
            "exclusion": site.exclusion is not None,
            "curved": site.curve_lines,
        }
        if site.quantities:
            shared["quantities"] = site.quantities
        self._shared = hashlib.sha256(json.dumps(shared, sort_keys=True).encode()).hexdigest()

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
        text = self._shared + json.dumps(own, sort_keys=True)
        return self.path / f"{hashlib.sha256(text.encode()).hexdigest()[:20]}.npz"

    def has(self, key: Case) -> bool:
        return self.read(key) is not None

    def read(self, key: Case) -> Found | None:
        try:
            return read_archive(self.file(key))[1]
        except Exception:  # any error about damaged bytes: such a file is computed again
            return None

    def write(self, key: Case, found: Found) -> None:
        write_archive(self.file(key), found)

    def runs_of(self, storm: Storm, seeds: Sequence[int] | None = None) -> tuple[list[Found], list[Table]]:
        """Successful runs of a load case, and a row for every other run."""
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

    def maxima(self, runs: Sequence[Found], line: str) -> np.ndarray:
        """Maximum tension (seeds,) [N] of a line."""
        return np.array([run["largest"][self.links[line]].max() for run in runs])
