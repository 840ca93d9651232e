"""Runs of load cases on disk: one file each, written atomically, with a name derived from all of its inputs.

The name identifies a run that is requested again, after a stop or together with new sea states, seeds or states.
Factors, capacities and anchors are not part of it: they may change without a new run.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from pathlib import Path

from dropper_jax.base.errors import SceneError
from dropper_jax.base.store import Store, StoreStopped, read_archive, write_archive
from fitting.farm.cases.one import Found
from fitting.farm.site import Case, Site

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

    def __init__(self, folder: str | Path, site: Site) -> None:
        self.path, self.site = Path(folder) / RUNS, site
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
            **({"quantities": site.quantities} if site.quantities else {}),
        }
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
        return zipfile.is_zipfile(self.file(key))

    def read(self, key: Case) -> Found | None:
        try:
            return read_archive(self.file(key))[1]
        except Exception:  # any error about damaged bytes: such a file is computed again
            return None

    def write(self, key: Case, found: Found) -> None:
        write_archive(self.file(key), found)
