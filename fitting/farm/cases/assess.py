"""Utilisation of parts and anchors over all load cases, from the stored runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.evaluation.fatigue import YEAR, damage
from fitting.farm.cases.case_store import CaseStore
from fitting.farm.cases.characteristic import characteristic_load
from fitting.farm.cases.flags import FINAL_SEEDS, exceeds_uplift, flags_of
from fitting.farm.cases.run_arrays import RunArrays
from fitting.farm.site import Anchor, Part, Site, Storm

#: Below 1 % of its mean a load has no defined direction.
NO_DIRECTION = 0.01


def assess(site: Site, folder: str | Path, step: Table | None = None) -> Table:
    """All content of the report, as plain values.

    The utilisation of a part in a case is that of its worst line, `factor * characteristic load / capacity`. Its error
    is the sampling error of the load; `step` is the step error of the worst case (see `fitting.farm.cases.run`).

    Args:
        step: errors by part, from `step_errors`.
    """
    runs = CaseStore(folder, site)
    rows: dict[str, list[Table]] = {part.name: [] for part in site.parts}
    fixed = site.scene.fixed_points
    by_point: dict[str, list[Table]] = {name: [] for name in fixed}
    anchors = {name: anchor for anchor in site.anchors for name in anchor.points}
    cases = []
    failed = []
    for storm in site.storms:
        good, bad = runs.runs_of(storm)
        failed += bad
        cases.append({**_labels(site, storm), "runs": len(good), "failed": len(bad)})
        if not good:
            continue
        cases[-1] |= _position_results(site, storm, good)
        for part in site.parts:
            rows[part.name].append(_part_row(site, part, storm, runs, good))
        for number, name in enumerate(fixed):
            loads = [run["held_loads"][:, number].astype(float) for run in good]
            by_point[name].append(_anchor_row(site, anchors.get(name), storm, loads))
    found = {
        "status": "failed" if failed else "ok",
        **_site_values(site),
        "final_check": len(site.seeds) >= FINAL_SEEDS and not failed,
        "cases": cases,
        "parts": [_assess_part(part, rows[part.name], site, (step or {}).get(part.name)) for part in site.parts],
        "anchors": [_assess_point(name, anchors.get(name), by_point[name]) for name in fixed],
        "exclusion": _exclusion(site, cases),
        "backbone": _backbone(site, cases),
        "failed": failed,
    }
    found["flags"] = flags_of(found, site)
    found["passes"] = _passes(found)
    return found


def _site_values(site: Site) -> Table:
    """What the report says of the site and its runs."""
    return {
        "schema": 1,
        "site": site.name,
        "scene": site.scene.name,
        "dt_s": site.steps.get("dt"),
        "accuracy": site.steps.get("accuracy"),
        "duration_s": site.run.duration,
        "skip_s": site.run.skip,
        "seeds": len(site.seeds),
        "characteristic": site.run.characteristic,
        "factors": asdict(site.factors),
        "standard": site.lists.standard,
    }


def _labels(site: Site, storm: Storm) -> Table:
    """What distinguishes a load case from others."""
    return {
        "case": storm.number,
        "name": storm.name,
        "sea_state": storm.sea_state.name,
        "direction_deg": np.degrees(storm.direction),
        "current": storm.current_name,
        "level_m": storm.level,
        "month": storm.month,
        "crop": storm.crop,
        "return_periods": storm.periods,
        "state": storm.state,
        "break_s": None if storm.broken is None else site.break_time,
    }


def _position_results(site: Site, storm: Storm, good: Sequence[RunArrays]) -> Table:
    """Maximum excursion [m] over the lines of the exclusion zone, depths of the backbone at rest [m], breaks."""
    found: Table = {"broken": sum(len(run["broken"]) for run in good)}
    own = site.run_of(storm)
    for name in site.quantities:
        kind = own
        if not name.endswith(".max"):  # other statistics have no maximum of a storm
            kind = replace(own, characteristic="mean")
        value = characteristic_load(column(good, f"quantity:{name}"), kind)
        found.setdefault("quantities", {})[name] = asdict(value)
    if site.exclusion is not None:
        rows = list(map(site.lines.index, site.matching(site.exclusion.lines)))
        excursion = characteristic_load([run["excursion"][rows].max() for run in good], own)
        found["excursion_m"] = asdict(excursion)
    if site.backbone is not None:
        rows = list(map(site.lines.index, site.matching(site.backbone.lines)))
        depth = good[0]["depth"][rows]
        found["depth_m"] = [depth[:, 0].min(), depth[:, 1].max()]
    return found


def _part_row(site: Site, part: Part, storm: Storm, runs: CaseStore, good: Sequence[RunArrays]) -> Table:
    """A part in one case, represented by its worst line."""
    factor = part.factors.by_kind[storm.kind]
    run = site.run_of(storm)
    found = [characteristic_load(runs.maxima(good, name), run) for name in part.lines]
    share = np.array([load.value for load in found]) * factor / part.capacity
    worst = np.argmax(share)
    load = found[worst]
    capacity = part.capacity[worst]
    links = runs.links[part.lines[worst]]
    first = good[0]
    after_break_s = None
    if storm.broken is not None:
        after_break_s = first["when"][links][np.argmax(first["largest"][links])] - site.break_time
    return {
        "case": storm.number,
        "line": part.lines[worst],
        "load_n": load.value,
        "load_error_n": load.error,
        "interval_n": load.interval,
        "kind": load.kind,
        "at_rest_n": first["rest"][links].max(),
        "mean_n": np.mean([run["mean"][links].max() for run in good]),
        "capacity_n": capacity,
        "factor": factor,
        "utilisation": share[worst],
        "utilisation_error": load.error_of(factor / capacity),
        "after_break_s": after_break_s,
        "damage_per_hour": _damage(part, good, run.duration - run.skip),
    }


def _damage(part: Part, good: Sequence[RunArrays], counted: float) -> float | None:
    """Damage per hour of the part's worst line, mean over the seeds; None without a curve or without cycles."""
    if part.curve is None:
        return None
    found = np.zeros((len(part.lines), len(good)))
    for i, (name, capacity) in enumerate(zip(part.lines, part.capacity, strict=True)):
        for j, run in enumerate(good):
            cycles = [rows for key, rows in run.items() if key.startswith(f"cycles:{name}:")]
            if not cycles:
                return None
            whole = [np.insert(rows, 1, 0.0, axis=1).astype(float) for rows in cycles]
            found[i, j] = max(damage(rows, capacity, part.curve.k, part.curve.m) for rows in whole)
    return found.mean(axis=1).max() * 3600.0 / counted


def _anchor_row(site: Site, anchor: Anchor | None, storm: Storm, loads: Sequence[np.ndarray]) -> Table:
    """A fixed point in one case: loads, uplift and utilisation, each the characteristic value of the seeds' maxima.

    Args:
        anchor: of the point, None if the site does not define one.
        loads: horizontal and upward loads (k, 2) [N] of each seed.
    """
    run = site.run_of(storm)
    total = characteristic_load([np.hypot(*load.T).max() for load in loads], run)
    upward = characteristic_load([load[:, 1].max() for load in loads], run)
    row: Table = {
        "case": storm.number,
        "total_n": asdict(total),
        "upward_n": asdict(upward),
        "uplift_deg": max(map(_uplift, loads)),
        "utilisation": None,
        "utilisation_error": None,
    }
    if anchor is not None:
        factor = anchor.factor[storm.kind]
        used = characteristic_load([anchor.table.utilisation(*load.T).max() for load in loads], run)
        error = used.error_of(factor)
        row |= {"factor": factor, "utilisation": factor * used.value, "utilisation_error": error}
    return row


def _uplift(load: np.ndarray) -> float:
    """Maximum angle [deg] above the horizontal of loads (k, 2), among those that have a direction."""
    size = np.hypot(*load.T)
    loaded = load[size >= max(NO_DIRECTION * size.mean(), 1e-12)]
    if not len(loaded):
        return 0.0
    return np.degrees(np.arctan2(loaded[:, 1], loaded[:, 0]).max())


def _assess_point(name: str, anchor: Anchor | None, rows: list[Table]) -> Table:
    """A fixed point over all cases: its rows, the worst of them, and the uplift with its limit [deg]."""

    def load(row: Table) -> float:
        if anchor is None:
            return row["total_n"]["value"]
        return row["utilisation"]

    return {
        "point": name,
        "anchor": None if anchor is None else anchor.name,
        "cases": rows,
        "worst": max(rows, key=load, default=None),
        "uplift_deg": max(column(rows, "uplift_deg"), default=None),
        "allowed_uplift_deg": None if anchor is None else anchor.table.uplift,
    }


def _assess_part(part: Part, rows: list[Table], site: Site, step: Table | None) -> Table:
    """A part over all cases: its factors, its rows, the worst of them, step error and fatigue."""
    return {
        "part": part.name,
        "lines": len(part.lines),
        "factors": asdict(part.factors),
        "cases": rows,
        "worst": max(rows, key=lambda row: row["utilisation"], default=None),
        "step": step,
        "fatigue": _fatigue(part, rows, site),
    }


def _fatigue(part: Part, rows: list[Table], site: Site) -> Table:
    """Damage of a year over the intact cases: the hours of a sea state, distributed evenly over its intact cases."""
    if part.curve is None:
        return {"skipped": "no curve given"}
    if any(row["damage_per_hour"] is None for row in rows):
        return {"skipped": "cycles were not counted: the package rainflow is missing (extra `fatigue`)"}
    storms = {storm.number: storm for storm in site.storms}
    intact = [row for row in rows if storms[row["case"]].broken is None]
    found = {
        "curve": asdict(part.curve),
        "largest_damage_per_hour": max(column(rows, "damage_per_hour"), default=None),
        "damage_per_year": None,
        "life_years": None,
    }
    hours = {state.name: state.hours for state in site.sea_states if state.hours is not None}
    if not hours:
        return found | {"why": "no sea state has `hours`"}
    by_state: dict[str, list[float]] = {}
    for row in intact:
        name = storms[row["case"]].sea_state.name
        if name in hours:
            by_state.setdefault(name, []).append(row["damage_per_hour"])
    if not by_state:
        return found | {"why": "no intact case is in a sea state with `hours`"}
    yearly = sum(hours[name] * np.mean(own) for name, own in by_state.items())
    found["damage_per_year"] = yearly
    if yearly > 0.0:
        found["life_years"] = 1.0 / yearly
    return found | {"share_of_year": sum(hours[name] for name in by_state) * 3600.0 / YEAR}


def _exclusion(site: Site, cases: list[Table]) -> Table | None:
    """The case with the largest excursion of nodes."""
    rows = [case for case in cases if "excursion_m" in case]
    if site.exclusion is None or not rows:
        return None
    worst = max(rows, key=lambda case: case["excursion_m"]["value"])
    limit = site.exclusion.excursion
    used = worst["excursion_m"]["value"] / limit
    return {"case": worst["case"], **worst["excursion_m"], "allowed_m": limit, "utilisation": used}


def _backbone(site: Site, cases: list[Table]) -> Table | None:
    """Depths of the backbone at rest over all cases."""
    rows = [case for case in cases if "depth_m" in case]
    if site.backbone is None or not rows:
        return None
    high = min(rows, key=lambda case: case["depth_m"][0])
    low = max(rows, key=lambda case: case["depth_m"][1])
    shallowest = high["depth_m"][0]
    deepest = low["depth_m"][1]
    return {
        "shallowest_m": shallowest,
        "shallowest_case": high["case"],
        "deepest_m": deepest,
        "deepest_case": low["case"],
        "allowed_m": [site.backbone.shallowest, site.backbone.deepest],
        "holds": site.backbone.holds(shallowest, deepest),
    }


def _passes(found: Table) -> bool:
    """Whether every limit holds in every case and no run failed; `flags` report seeds and steps that do not suffice."""
    parts = [part["worst"] for part in found["parts"] if part["worst"] is not None]
    rows = (*parts, *column(found["anchors"], "worst"), found["exclusion"])
    limits = all((row["utilisation"] or 0.0) <= 1.0 for row in rows if row)
    backbone = found["backbone"] is None or found["backbone"]["holds"]
    uplift = any(map(exceeds_uplift, found["anchors"]))
    return limits and backbone and not uplift and not found["failed"] and bool(parts)
