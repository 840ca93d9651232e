"""Runs of load cases on disk: one file each, written atomically, with a name derived from all of its inputs.

The name identifies a run that is requested again, after a stop or together with new sea states, seeds or states.
Factors, capacities and anchors are not part of it: they may change without a new run.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import atomic_write
from fitting.cases.tally import Found
from fitting.site import Case, Site

#: Increased when older files can no longer be used.
FORMAT = 2
RUNS = "runs"


class Store:
    """The folder of a site's runs with one step.

    Raises:
        SceneError: the folder cannot be made, or is a file.
    """

    def __init__(self, folder: str | Path, site: Site, dt: float) -> None:
        self.folder, self.site = Path(folder) / RUNS, site
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SceneError(f"--out: {str(folder)!r} cannot be made: {error.strerror or error}") from None
        run = site.run
        curved = [name for part in site.parts if part.curve is not None for name in part.lines]
        shared = {
            "format": FORMAT,
            "scene": site.scene.as_written(),
            "run": [run.duration, dt, run.skip, run.ramp],
            "exclusion": site.exclusion is not None,
            "curved": curved,
            **({"quantities": site.quantities} if site.quantities else {}),
        }
        self._shared = hashlib.sha256(json.dumps(shared, sort_keys=True).encode()).hexdigest()

    def path(self, case: Case) -> Path:
        """The file of a run."""
        storm = case.storm
        own = {
            "changes": self.site.still_changes(storm),
            "waves": storm.sea_state.waves(storm.direction, case.seed),
            "broken": None if storm.broken is None else [storm.broken.line, storm.broken.link, self.site.break_time],
        }
        text = self._shared + json.dumps(own, sort_keys=True)
        return self.folder / f"{hashlib.sha256(text.encode()).hexdigest()[:20]}.npz"

    def read(self, case: Case) -> Found | None:
        """Arrays of a run; None if it is not stored."""
        try:
            with self.path(case).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                return dict(arrays)
        except (OSError, ValueError, zipfile.BadZipFile, EOFError):  # a damaged file is computed again
            return None

    def has(self, case: Case) -> bool:
        """Whether a run is stored, without reading its arrays."""
        return zipfile.is_zipfile(self.path(case)) if self.path(case).exists() else False

    def write(self, case: Case, found: Found) -> None:
        """Keep a run."""
        atomic_write(self.path(case), _writer(found))


def _writer(found: Found) -> Callable[[BinaryIO], None]:
    return lambda file: np.savez_compressed(file, **found)
