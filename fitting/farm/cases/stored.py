"""The stored runs of a site, load case by load case."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.scene import whole_lines
from fitting.farm.cases.case_store import CaseStore
from fitting.farm.cases.one import STATUS, Found
from fitting.farm.site import Case, Site, Storm


class Runs:
    """The stored runs of a site, load case by load case; only one is in memory at a time."""

    def __init__(self, site: Site, folder: str | Path) -> None:
        self.site, self.store = site, CaseStore(folder, site)
        self.links = {line.name: line.links for line in whole_lines(site.scene)}
        self.held = [point.name for point in site.scene.points if not point.is_free]

    def of(self, storm: Storm, seeds: Sequence[int] | None = None) -> tuple[list[Found], list[Table]]:
        """Successful runs of a load case, and a row for every other run."""
        good = []
        bad = []
        for seed in self.site.seeds if seeds is None else seeds:
            found = self.store.read(Case(storm, seed)) or {}
            code = "missing"
            if found:
                code = STATUS[int(found["status"])]
            if code == "ok":
                good.append(found)
                continue
            at = None
            if "failed_at" in found:
                at = float(found["failed_at"])
            why = str(found.get("message", ""))
            bad.append({"case": storm.number, "seed": seed, "status": code, "time_s": at, "why": why})
        return good, bad

    def maxima(self, runs: Sequence[Found], line: str) -> np.ndarray:
        """Maximum tension (seeds,) [N] of a line."""
        return np.array([run["largest"][self.links[line]].max() for run in runs])
