"""Characteristic loads of load cases, and the warnings of the report, one line each."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.evaluation.extremes import storm_extreme
from dropper_jax.study.load_errors import UNRESOLVED
from fitting.farm.site import Site
from fitting.farm.site.sections import RunValues

#: Minimum number of seeds for a final check.
FINAL_SEEDS = 10


@dataclass(frozen=True)
class Characteristic:
    """Characteristic load of a case.

    Attributes:
        error: standard error; None with one seed.
        interval: None with fewer than three seeds or without a distribution.
        kind: the computed quantity, `mean` or `most_probable`.
    """

    value: float
    error: float | None
    interval: tuple[float, float] | None
    seeds: int
    kind: str


def characteristic(maxima: np.ndarray, run: RunValues) -> Characteristic:
    """Mean of the seeds' maxima (seeds,), or the most probable maximum of a storm.

    The standard error of the mean is `s/sqrt(n)`. The interval of either is that of a Gumbel distribution (see
    `evaluation.extremes.storm_extreme`). The standard error of the most probable value is half of a 68 % interval.
    """
    maxima = np.asarray(maxima, float)
    n = len(maxima)
    counted = run.duration - run.skip
    error = None
    if n > 1:
        error = float(maxima.std(ddof=1) / np.sqrt(n))
    mean = Characteristic(float(maxima.mean()), error, None, n, "mean")
    whole = storm_extreme(maxima, counted, counted, run.confidence)
    if "skipped" in whole:
        return mean
    if run.characteristic == "mean":
        return replace(mean, interval=whole["mean_interval"])
    storm = storm_extreme(maxima, counted, run.storm, run.confidence)
    low, high = storm_extreme(maxima, counted, run.storm, 0.6827)["most_probable_interval"]
    interval = storm["most_probable_interval"]
    return Characteristic(storm["most_probable"], 0.5 * (high - low), interval, n, "most_probable")


def flags_of(found: Table, site: Site) -> list[str]:
    """Lines about seeds, steps, limits that are exceeded or undecided, and failed runs."""
    notes = []
    if found["failed"]:
        rows = found["failed"]
        first = rows[0]
        at = ""
        if first["time_s"] is not None:
            at = f" at {first['time_s']:.4g} s"
        why = f": {first['why']}" if first["why"] else ""
        notes.append(
            f"{len(rows)} of {len(site.cases)} runs are missing or failed, the first in case {first['case']}, seed "
            f"{first['seed']} ({first['status']}{at}{why}): their cases are not assessed with all seeds"
        )
    if found["seeds"] < FINAL_SEEDS:
        notes.append(f"not a final check: {found['seeds']} of at least {FINAL_SEEDS} seeds")
    if found["standard"] and found["standard"]["broken"] and "broken" not in site.kinds:
        notes.append(f"{found['standard']['name']}: the check includes one broken line; `states` has none")
    for part in found["parts"]:
        notes += _part(part)
    for case in found["cases"]:
        if case["state"] != "intact" and case["runs"] and case["broken"] < case["runs"]:
            notes.append(f"case {case['case']}: {case['state']} did not break in all runs")
    for anchor in found["anchors"]:
        worst = anchor["worst"]
        if anchor["anchor"] is None:
            notes.append(f"point {anchor['point']}: fixed, but without an [[anchor]] that gives its capacity")
        elif worst is not None:
            notes += _limit(f"anchor {anchor['point']}", worst)
        allowed = anchor["allowed_uplift_deg"]
        if allowed is not None and anchor["uplift_deg"] is not None and anchor["uplift_deg"] > allowed:
            notes.append(f"anchor {anchor['point']}: uplift {anchor['uplift_deg']:.3g} deg; allowed: {allowed:g} deg")
    zone = found["exclusion"]
    if zone is not None and zone["utilisation"] > 1.0:
        notes.append(f"exclusion: {zone['value']:.3g} m in case {zone['case']}; allowed: {zone['allowed_m']:g} m")
    if found["backbone"] is not None and not found["backbone"]["holds"]:
        own = found["backbone"]
        notes.append(
            f"backbone: {own['shallowest_m']:.3g} to {own['deepest_m']:.3g} m deep at rest, outside its limits"
        )
    return notes


def _part(part: Table) -> list[str]:
    worst = part["worst"]
    step = part["step"]
    if worst is None:
        return [f"part {part['part']}: no run to assess it by"]
    notes = _limit(f"part {part['part']}", worst)
    if step is None:
        notes.append(f"part {part['part']}: step error unknown")
    elif "skipped" in step:
        notes.append(f"part {part['part']}: step error unknown: {step['skipped']}")
    elif step["relative"] > UNRESOLVED:
        notes.append(f"part {part['part']}: step error {step['relative']:.0%} of its maximum load: not resolved")
    return notes


def _limit(name: str, row: Table) -> list[str]:
    used = row["utilisation"]
    error = row["utilisation_error"]
    if used > 1.0:
        return [f"{name}: utilisation {used:.2f} in case {row['case']}: too weak"]
    if error is not None and used + error > 1.0:
        return [f"{name}: utilisation {used:.2f} +- {error:.2f} in case {row['case']}: not decided"]
    return []
