"""The report as plain values: one run, or several runs of the same lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.numerics import spread
from dropper_jax.base.read import Table
from dropper_jax.base.store import flat_items
from dropper_jax.evaluation.extremes import line_snaps, storm_extreme
from dropper_jax.evaluation.fatigue import line_fatigue
from dropper_jax.evaluation.record import Record, record
from dropper_jax.evaluation.settings import Settings
from dropper_jax.evaluation.tension import anchors, line_tensions
from dropper_jax.load.checks_water import bed_height, surface_over
from dropper_jax.load.scene import Scene
from dropper_jax.report.cells import Rows
from dropper_jax.report.motion import accelerations, line_distances, node_arc, node_rows, watch_circles
from dropper_jax.report.parts import body_motions, crops, parts
from dropper_jax.run.bends import bending_moment, bending_summary, bends, curvature
from dropper_jax.run.flow_coefficients import flow_table, follows
from dropper_jax.run.growth import overgrown
from dropper_jax.run.line_weights import line_weights
from dropper_jax.run.simulate import Solution
from dropper_jax.scene import BuoySpec, sliced_lines, whole_lines
from dropper_jax.scene.data import point_nodes


def report_run(solution: Solution, settings: Settings | None = None) -> Table:
    """All values of the report of one run; a section that does not apply is `{"skipped": why}`.

    Raises:
        SceneError: the run has fewer than three good samples.
    """
    settings = settings or Settings()
    part = record(solution, settings.skip)
    used = solution.settings
    accuracy = used.get("accuracy")
    tension = line_tensions(part, settings)
    snap = line_snaps(part, settings)
    try:
        fatigue = line_fatigue(part, settings)
    except SceneError as error:  # the package of an extra is missing: the rest of the report is valid
        fatigue = {"skipped": str(error)}
    damping = [line.axial_damping for line in solution.scene.lines if line.axial_damping is not None]
    return {
        "scene": solution.scene.name,
        "status": solution.status,
        "integrator": used.get("integrator"),
        "dt_s": used.get("dt") if accuracy is None else None,
        "accuracy": accuracy,
        "internal_damping_n_s": float(max(map(np.max, damping), default=0.0)),
        "saved_every_s": part.interval,
        "from_s": float(part.t[0]),
        "to_s": float(part.t[-1]),
        "samples": len(part.t),
        "retried_steps": solution.retried_steps,
        "line_weights": line_weights(solution.scene),
        "link_mass_nodes": solution.scene.link_mass_nodes,
        "notes": list(part.notes),
        "broken": list(solution.broken),
        "parts": parts(tension, snap, fatigue),
        "tension": tension,
        "anchors": anchors(part) or {"skipped": "the scene has no fixed point"},
        "bending": line_bending(part),
        "snap": snap,
        "fatigue": fatigue,
        "watch_circle": watch_circles(part),
        "acceleration": accelerations(part),
        "submergence": submergence(part),
        "distance": line_distances(part),
        "seabed": bed_contact(part, settings),
        "coefficients": flow_coefficients(part.scene),
        "bodies": body_motions(part),
        "crop": crops(part),
    }


def report_runs(solutions: dict[str, Solution], settings: Settings | None = None) -> Table:
    """The report of runs by name (their files): each run, their spread and, for three or more runs, the extremes of a
    storm.

    Raises:
        SceneError: runs whose lines differ; a run with fewer than three good samples.
    """
    settings = settings or Settings()
    _same_lines(solutions)
    runs = {name: report_run(solution, settings) for name, solution in solutions.items()}
    return {
        "schema": 1,
        "status": next((run["status"] for run in runs.values() if run["status"] != "ok"), "ok"),
        "settings": settings.table(),
        "runs": [{"file": Path(name).name, **run} for name, run in runs.items()],
        "spread": _spread(list(runs.values())),
        "extremes": _extremes(list(runs.values()), _not_seeds(solutions), settings),
    }


def _same_lines(solutions: dict[str, Solution]) -> None:
    known = None
    for name, solution in solutions.items():
        lines = [(line.name, line.spec.links, line.pieces) for line in whole_lines(solution.scene)]
        known = known or (name, lines)
        if lines != known[1]:
            raise SceneError(f"{name}: its lines differ from those of {known[0]}; allowed: runs of the same lines")


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
                rows[f"damage per year of {line['line']}"] = [f["damage_per_year"] for f in own]
    return {
        "dt_s": [r["dt_s"] for r in runs],
        "accuracy": [r["accuracy"] for r in runs],
        "internal_damping_n_s": [r["internal_damping_n_s"] for r in runs],
        "values": {
            name: {"min": min(v), "mean": float(np.mean(v)), "max": max(v), "by_run": v} for name, v in rows.items()
        },
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
    if differ:
        return {"skipped": f"the runs differ in more than the seed of their sea: {', '.join(differ[:5])}"}
    durations = [run["to_s"] - run["from_s"] for run in runs]
    if len(runs) > 1 and np.ptp(durations) > 1e-3 * max(durations):
        return {"skipped": "the runs have different durations: their maxima are of different distributions"}
    found = {}
    for name, peaks in _peaks(runs).items():
        found[name] = storm_extreme(np.array(peaks), durations[0], settings.storm, settings.confidence)
    why = {item.get("skipped") for item in found.values()}
    if len(why) == 1 and None not in why:
        return {"skipped": why.pop()}
    return found


def bed_contact(record: Record, settings: Settings) -> Rows:
    """Per line: length on the seabed [m] over time, and fraction of time of each node.

    A node is on the seabed if it is at most `contact` above it, a link if both its ends are. The length is a number of
    complete links, so it is zero for a line that rises from an anchor on the seabed.
    """
    bed = bed_height(record.scene, record.positions)
    if bed is None:
        return {"skipped": "the scene has no [effects.seabed]"}
    on = record.positions[..., 2] - bed <= settings.contact
    found = []
    for row, where in node_rows(record):
        own = on[:, where.nodes]
        length = (own[:, :-1] & own[:, 1:]) @ np.asarray(where.spec.length, float)
        found.append(
            {
                **row,
                "length_m": spread(length, ("min", "mean", "max")),
                "share_of_line": float(length.mean() / where.spec.total),
                "share_of_time": own.mean(axis=0),
                "share_with_contact": float(np.mean(length > 0)),
            }
        )
    return found


def flow_coefficients(scene: Scene) -> Rows:
    """Coefficients that depend on the flow, per line."""
    if follows(scene):
        return flow_table(overgrown(scene))
    return {"skipped": "the scene has no flow-dependent coefficients"}


def line_bending(record: Record) -> Rows:
    """Per line the maximum moment [N m], its arc length [m] and time [s], the minimum radius [m], and the maximum and
    mean moment of each node [N m] against arc length from the first point [m]."""
    scene = record.scene
    if not bends(scene):
        return {"skipped": "the scene has no [effects.bending]"}
    kappa = curvature(scene, record.positions, record.t)
    moment = bending_moment(scene, record.positions, record.t, tuple(record.solution.broken))
    summary = bending_summary(scene, record.t, kappa, moment)
    found = []
    for line, where in sliced_lines(scene):
        own = moment[:, where.nodes]
        along = {"length_m": node_arc(line.length), "max_n_m": own.max(axis=0)}
        found.append({"line": line.name, **summary[line.name], **along, "mean_n_m": own.mean(axis=0)})
    return found


def submergence(record: Record) -> Table:
    """Per line the fraction of time under the actual surface and the depth [m] of its nodes; per buoy the draught."""
    if record.scene.sea is None:
        return {"skipped": "the scene has no water"}
    depth = surface_over(record.scene, record.positions, record.t) - record.positions[..., 2]
    lines = []
    for row, where in node_rows(record):
        own = depth[:, where.nodes]
        lines.append(
            {
                **row,
                "share_under_water": (own > 0).mean(axis=0),
                "mean_depth_m": own.mean(axis=0),
                "least_depth_m": own.min(axis=0),
                "largest_depth_m": own.max(axis=0),
            }
        )
    return {"lines": lines, "buoys": [_buoy(record, buoy, depth) for buoy in record.scene.buoys]}


def _buoy(record: Record, buoy: BuoySpec, depth: np.ndarray) -> Table:
    base = depth[:, point_nodes(record.scene)[buoy.point]] + buoy.attachment
    return {
        "buoy": buoy.name,
        "draught_m": spread(base, ("min", "mean", "max")),
        "height_m": buoy.height,
        "share_under_water": float(np.mean(base >= buoy.height)),
        "share_out_of_water": float(np.mean(base <= 0)),
        "longest_under_water_s": _longest(base >= buoy.height, record.t),
    }


def _longest(under: np.ndarray, t: np.ndarray) -> float:
    """Longest uninterrupted time [s] in which all samples are true."""
    edges = np.flatnonzero(np.diff(under.astype(int), prepend=0, append=0))
    return float(np.max(t[edges[1::2] - 1] - t[edges[::2]], initial=0.0))
