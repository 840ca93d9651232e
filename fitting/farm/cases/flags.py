"""Characteristic loads of load cases, and the warnings of the report, one line each."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.evaluation.extremes import storm_extreme
from dropper_jax.study.load_errors import UNRESOLVED_ERROR
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

    def error_of(self, scale: float) -> float | None:
        """The standard error of the load times a scale."""
        if self.error is None:
            return None
        return scale * self.error


def characteristic(maxima: np.ndarray, run: RunValues) -> Characteristic:
    """Mean of the seeds' maxima (seeds,), or the most probable maximum of a storm.

    The standard error of the mean is `s/sqrt(n)`. The interval of either is that of a Gumbel distribution (see
    `evaluation.extremes.storm_extreme`). The standard error of the most probable value is half of a 68 % interval.
    """
    maxima = np.asarray(maxima, float)
    n = len(maxima)
    counted = run.duration - run.skip
    error = float(maxima.std(ddof=1) / np.sqrt(n)) if n > 1 else None
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
        first = found["failed"][0]
        what = first["status"]
        if first["time_s"] is not None:
            what += f" at {first['time_s']:.4g} s"
        if first["why"]:
            what += f": {first['why']}"
        notes.append(
            f"{len(found['failed'])} of {len(site.cases)} runs are missing or failed, the first in case "
            f"{first['case']}, seed {first['seed']} ({what}): their cases are not assessed with all seeds"
        )
    if found["seeds"] < FINAL_SEEDS:
        notes.append(f"not a final check: {found['seeds']} of at least {FINAL_SEEDS} seeds")
    if found["standard"] and found["standard"]["broken"] and "broken" not in site.kinds:
        notes.append(f"{found['standard']['name']}: the check includes one broken line; `states` has none")
    for part in found["parts"]:
        notes += _part_notes(part)
    for case in found["cases"]:
        if case["state"] != "intact" and case["runs"] and case["broken"] < case["runs"]:
            notes.append(f"case {case['case']}: {case['state']} did not break in all runs")
    for anchor in found["anchors"]:
        point = anchor["point"]
        if anchor["anchor"] is None:
            notes.append(f"point {point}: fixed, but without an [[anchor]] that gives its capacity")
        elif anchor["worst"] is not None:
            notes += _limit_notes(f"anchor {point}", anchor["worst"])
        if exceeds_uplift(anchor):
            allowed = anchor["allowed_uplift_deg"]
            notes.append(f"anchor {point}: uplift {anchor['uplift_deg']:.3g} deg; allowed: {allowed:g} deg")
    zone = found["exclusion"]
    if zone is not None and zone["utilisation"] > 1.0:
        notes.append(f"exclusion: {zone['value']:.3g} m in case {zone['case']}; allowed: {zone['allowed_m']:g} m")
    own = found["backbone"]
    if own is not None and not own["holds"]:
        notes.append(
            f"backbone: {own['shallowest_m']:.3g} to {own['deepest_m']:.3g} m deep at rest, outside its limits"
        )
    return notes


def exceeds_uplift(anchor: Table) -> bool:
    """Whether the uplift of a fixed point is above its limit."""
    allowed = anchor["allowed_uplift_deg"]
    return allowed is not None and anchor["uplift_deg"] is not None and anchor["uplift_deg"] > allowed


def _part_notes(part: Table) -> list[str]:
    """Lines about a part: its limit and its step error."""
    name = f"part {part['part']}"
    step = part["step"]
    if part["worst"] is None:
        return [f"{name}: no run to assess it by"]
    notes = _limit_notes(name, part["worst"])
    if step is None:
        notes.append(f"{name}: step error unknown")
    elif "skipped" in step:
        notes.append(f"{name}: step error unknown: {step['skipped']}")
    elif step["relative"] > UNRESOLVED_ERROR:
        notes.append(f"{name}: step error {step['relative']:.0%} of its maximum load: not resolved")
    return notes


def _limit_notes(name: str, row: Table) -> list[str]:
    """A line if a utilisation is above 1, or may be within its error."""
    used = row["utilisation"]
    error = row["utilisation_error"]
    if used > 1.0:
        return [f"{name}: utilisation {used:.2f} in case {row['case']}: too weak"]
    if error is not None and used + error > 1.0:
        return [f"{name}: utilisation {used:.2f} +- {error:.2f} in case {row['case']}: not decided"]
    return []
