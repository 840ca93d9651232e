"""Flags of the report of load cases: seeds, steps, exceeded or undecided limits, and failed runs, one line each."""

from __future__ import annotations

from dropper_jax.base.read import Table
from dropper_jax.study.load_errors import UNRESOLVED_ERROR
from fitting.farm.site import Site

#: Minimum number of seeds for a final check.
FINAL_SEEDS = 10


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
    if found["characteristic"] == "most_probable":
        notes += _mean_notes(found)
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
    return notes + _position_notes(found)


def _position_notes(found: Table) -> list[str]:
    """Lines about an exclusion zone that nodes leave, and a backbone outside its depths."""
    notes = []
    zone = found["exclusion"]
    if zone is not None and zone["utilisation"] > 1.0:
        notes.append("exclusion: {value:.3g} m in case {case}; allowed: {allowed_m:g} m".format_map(zone))
    own = found["backbone"]
    if own is not None and not own["holds"]:
        line = "backbone: {shallowest_m:.3g} to {deepest_m:.3g} m deep at rest, outside its limits"
        notes.append(line.format_map(own))
    return notes


def _mean_notes(found: Table) -> list[str]:
    """A line on the parts and points whose load is a mean although a most probable maximum was asked for."""
    loads = {f"part {part['part']}": part["worst"] for part in found["parts"]}
    for anchor in found["anchors"]:
        loads[f"point {anchor['point']}"] = anchor["worst"] and anchor["worst"]["total_n"]
    means = [name for name, load in loads.items() if load is not None and load["kind"] == "mean"]
    if not means:
        return []
    return [
        f"{', '.join(means)}: the load is the mean of the seeds' maxima, not the most probable one of the storm: fewer "
        "than 3 seeds, or seeds with equal maxima or without load"
    ]


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
