"""Step error of maximum loads: worst cases are repeated with halved steps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.base.progress import Progress
from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from fitting.farm.cases.case_store import CaseStore
from fitting.farm.cases.run import run_cases
from fitting.farm.site import Case, Site


def step_errors(
    site: Site,
    folder: str | Path,
    found: Table,
    *,
    workers: int = 1,
    scheduler: Any = None,
    progress: Progress | None = None,
) -> Table:
    """Error of the load of each part in its worst case, by runs with half the step (and a quarter, `halvings` = 2).

    Where steps follow an accuracy a quarter of it is half the step.

    Let q be the mean over the first `step_seeds` seeds of the worst line's maxima. After k halvings the error is
    `2^k/(2^k - 1) |q(h) - q(h/2^k)|`, that of a scheme of first order: contact and slack reduce one of second order to
    this.

    Returns:
        by part {value_n, error_n, relative, by_step} or {skipped}; steps [s], or accuracies.
    """
    if not site.run.halvings:
        return {part["part"]: {"skipped": "run.halvings is 0"} for part in found["parts"]}
    worst = {part["part"]: part["worst"] for part in found["parts"] if part["worst"] is not None}
    numbers = dict.fromkeys(column(worst.values(), "case"))
    seeds = site.seeds[: site.run.step_seeds]
    cases = [Case(site.storms[number], seed) for number in numbers for seed in seeds]
    sites = [site, *map(site.finer, range(1, site.run.halvings + 1))]
    for finer in sites[1:]:
        run_cases(finer, folder, cases=cases, workers=workers, scheduler=scheduler, progress=progress)
    return {name: _error(sites, folder, row, seeds) for name, row in worst.items()}


def _error(sites: list[Site], folder: str | Path, row: Table, seeds: Sequence[int]) -> Table:
    """Error of the load of a part in its worst case `row`, from the runs of sites with ever finer steps."""
    means = {}
    for site in sites:
        runs = CaseStore(folder, site)
        good, bad = runs.runs_of(site.storms[row["case"]], seeds)
        ((key, value),) = site.steps.items()
        if bad:
            return {"skipped": f"a run with {key} = {value:g} ended with {bad[0]['status']}"}
        means[f"{value:g}"] = float(np.mean(runs.maxima(good, row["line"])))
    first, *_, last = means.values()
    gain = 2.0 ** (len(means) - 1)
    error = gain / (gain - 1.0) * abs(first - last)
    return {
        "case": row["case"],
        "line": row["line"],
        "value_n": first,
        "error_n": error,
        "relative": error / max(first, 1e-300),
        "by_step": means,
        "seeds": len(seeds),
    }
