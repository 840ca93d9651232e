"""The report as plain values: one run, or several runs of the same lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError, first_failure
from dropper_jax.base.numerics import spread
from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.base.store import flat_items
from dropper_jax.evaluation.extremes import storm_extreme
from dropper_jax.evaluation.fatigue import line_fatigue
from dropper_jax.evaluation.record import Record, record
from dropper_jax.evaluation.settings import DEFAULTS, Settings
from dropper_jax.evaluation.snaps import line_snaps
from dropper_jax.evaluation.tension import anchors, line_tensions
from dropper_jax.plausibility.line_weights import line_weights
from dropper_jax.report.distance import line_distances
from dropper_jax.report.lines import bed_contact, crops, flow_coefficients, line_bending, submergence
from dropper_jax.report.motion import accelerations, body_motions, watch_circles
from dropper_jax.report.parts import parts
from dropper_jax.run.simulate import Solution
from dropper_jax.scene import whole_lines


def report_run(solution: Solution, settings: Settings = DEFAULTS) -> Table:
    """All values of the report of one run; a section that does not apply is `{"skipped": why}`.

    Raises:
        SceneError: the run has fewer than three good samples.
    """
    evaluated = record(solution, settings.skip)
    tension = line_tensions(evaluated, settings)
    snap = line_snaps(evaluated, settings)
    try:
        fatigue = line_fatigue(evaluated, settings)
    except SceneError as error:  # the package of an extra is missing: the rest of the report is valid
        fatigue = {"skipped": str(error)}
    return {
        **_run_facts(solution, evaluated),
        "line_weights": line_weights(solution.scene),
        "link_mass_nodes": solution.scene.link_mass_nodes,
        "notes": list(evaluated.notes),
        "broken": list(solution.broken),
        "parts": parts(tension, snap, fatigue),
        "tension": tension,
        "anchors": anchors(evaluated) or {"skipped": "the scene has no fixed point"},
        "bending": line_bending(evaluated),
        "snap": snap,
        "fatigue": fatigue,
        "watch_circle": watch_circles(evaluated),
        "acceleration": accelerations(evaluated),
        "submergence": submergence(evaluated),
        "distance": line_distances(evaluated),
        "seabed": bed_contact(evaluated, settings),
        "coefficients": flow_coefficients(evaluated.scene),
        "bodies": body_motions(evaluated),
        "crop": crops(evaluated),
    }


def _run_facts(solution: Solution, evaluated: Record) -> Table:
    """Scene, status, scheme and samples of a run."""
    damping = [line.axial_damping for line in solution.scene.lines if line.axial_damping is not None]
    used = solution.settings
    accuracy = used.get("accuracy")
    return {
        "scene": solution.scene.name,
        "status": solution.status,
        "integrator": used.get("integrator"),
        "dt_s": used.get("dt") if accuracy is None else None,
        "accuracy": accuracy,
        "internal_damping_n_s": float(max(map(np.max, damping), default=0.0)),
        "saved_every_s": evaluated.interval,
        "from_s": float(evaluated.t[0]),
        "to_s": float(evaluated.t[-1]),
        "samples": len(evaluated.t),
        "retried_steps": solution.retried_steps,
    }


def report_runs(solutions: dict[str, Solution], settings: Settings = DEFAULTS) -> Table:
    """The report of runs by name (their files): each run, their spread and, for three or more runs, the extremes of a
    storm.

    Raises:
        SceneError: runs whose lines differ; a run with fewer than three good samples.
    """
    _same_lines(solutions)
    runs = {name: report_run(solution, settings) for name, solution in solutions.items()}
    return {
        "schema": 1,
        "status": first_failure(column(runs.values(), "status")) or "ok",
        "settings": settings.table(),
        "runs": [{"file": Path(name).name, **run} for name, run in runs.items()],
        "spread": _spread(list(runs.values())),
        "extremes": _extremes(list(runs.values()), _not_seeds(solutions), settings),
    }


def _same_lines(solutions: dict[str, Solution]) -> None:
    """Reject runs whose lines have other names or links than those of the first, and no runs."""
    if not solutions:
        raise SceneError("solutions: are empty; needed: one run or more")
    known = {}
    for name, solution in solutions.items():
        known[name] = [(line.name, line.spec.links, line.pieces) for line in whole_lines(solution.scene)]
    first = next(iter(known))
    for name, lines in known.items():
        if lines != known[first]:
            raise SceneError(f"{name}: its lines differ from those of {first}; allowed: runs of the same lines")


def _peaks(runs: list[Table]) -> dict[str, list[float]]:
    """Values compared between runs: maximum tension of each line, maximum load of each anchor [N], by run."""
    found = {}
    for i, line in enumerate(runs[0]["tension"]):
        found[f"tension of {line['line']}"] = [r["tension"][i]["largest"]["n"] for r in runs]
    if isinstance(runs[0]["anchors"], list):
        for i, anchor in enumerate(runs[0]["anchors"]):
            found[f"load of {anchor['point']}"] = [r["anchors"][i]["total_n"]["max"] for r in runs]
    return found


def _spread(runs: list[Table]) -> Table:
    """Minimum, mean and maximum over the runs of maximum loads, mean tensions and fatigue, with each run's step."""
    if len(runs) < 2:
        return {"skipped": "one run"}
    rows = dict(_peaks(runs))
    for i, line in enumerate(runs[0]["tension"]):
        rows[f"mean tension at the end of {line['line']}"] = [r["tension"][i]["mean_last_link_n"] for r in runs]
        if all(isinstance(r["fatigue"], list) for r in runs):
            own = [r["fatigue"][i] for r in runs]
            rows[f"equivalent range of {line['line']}"] = [max(f["equivalent_range_n"]) for f in own]
            if all(f["damage"] is not None for f in own):
                rows[f"damage per year of {line['line']}"] = column(own, "damage_per_year")
    statistics = {name: spread(np.array(v), ("min", "mean", "max")) | {"by_run": v} for name, v in rows.items()}
    return {
        "dt_s": column(runs, "dt_s"),
        "accuracy": column(runs, "accuracy"),
        "internal_damping_n_s": column(runs, "internal_damping_n_s"),
        "values": statistics,
    }


def _not_seeds(solutions: dict[str, Solution]) -> list[str]:
    """Paths of the scenes in which the runs differ, except texts and the seed of the sea."""
    tables = [dict(flat_items(s.scene.to_dict())) | {"run.dt": s.settings.get("dt")} for s in solutions.values()]
    paths = {path for table in tables for path in table} - {"name", "description", "sea.waves.seed"}
    found = []
    for path in sorted(paths):
        if any(table.get(path) != tables[0].get(path) for table in tables):
            found.append(path)
    return found


def _extremes(runs: list[Table], differ: list[str], settings: Settings) -> Table:
    """Extremes of a storm by quantity, or the reason for their absence; `differ` are paths in which the runs differ."""
    if differ:
        return {"skipped": f"the runs differ in more than the seed of their sea: {', '.join(differ[:5])}"}
    durations = [run["to_s"] - run["from_s"] for run in runs]
    if len(runs) > 1 and np.ptp(durations) > 1e-3 * max(durations):
        return {"skipped": "the runs have different durations: their maxima are of different distributions"}
    how = (durations[0], settings.storm, settings.confidence)
    found = {name: storm_extreme(np.array(peaks), *how) for name, peaks in _peaks(runs).items()}
    why = {item.get("skipped") for item in found.values()}
    if len(why) == 1 and None not in why:
        return {"skipped": why.pop()}
    return found
