"""The JSON object of a run, and its tables as CSV.

Numbers are written with all digits, so that reading them gives identical values.
"""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np

from dropper_jax.analysis.angles import link_angles
from dropper_jax.base.files import atomic_write
from dropper_jax.base.json_values import SCHEMA, jsonable
from dropper_jax.base.read import Table
from dropper_jax.integrators import OPTIONS
from dropper_jax.plausibility.line_weights import line_weights
from dropper_jax.quantities.bending import bending_summary
from dropper_jax.run.samples import Samples
from dropper_jax.run.step_facts import step_facts
from dropper_jax.scene import line_offsets


def summary(run: Samples) -> Table:
    """The JSON object of a run; NaN and infinity are null."""
    scheme = ("integrator", "solver", "dtype", "dt", "duration", "steps")
    keys = (*scheme, *OPTIONS, "residual_tolerance", "save_every")
    found = {
        "schema": SCHEMA,
        "status": run.status,
        "scene": run.scene.name,
        **{key: run.settings.get(key) for key in keys},
        "failed_steps": run.failed_steps,
        "retried_steps": run.retried_steps,
        "first_bad": run.first_bad,
        "max_residual": run.max_residual,
        "max_closure_error_m": run.max_closure_error,
        "energy_drift_j": run.energy_drift,
        "energy_scale_j": run.energy_scale,
        "work_j": dict(zip(run.work_names, run.work[-1], strict=True)),
        "axial_ringing_share": run.axial_ringing_share,
        "max_speed_m_per_s": run.max_speed,
        "compile_s": run.compile_s,
        "run_s": run.run_s,
        "us_per_step": run.us_per_step,
        "realtime_factor": run.realtime_factor,
        "final_time_s": run.t[-1],
        "final_positions_m": run.positions[-1],
        "saved_rows": run.saved_rows or "every step is saved",
        "tension_n": run.tension_summary(),
        "step_facts": step_facts(run),
        "end_forces_n": run.end_forces(),
        "end_angles_deg": run.end_angles(),
        "line_weights": line_weights(run.scene),
        "link_mass_nodes": run.scene.link_mass_nodes,
        "broken": run.broken,
        "stated_errors": run.settings.get("stated_errors"),
        "warnings": run.warnings,
        "versions": run.versions,
    }
    if run.continues:
        found["continued_from_s"] = run.t[0]
    if run.scene.branched:
        found["tension_of_lines_n"] = run.line_tensions()
        found["lines"] = line_offsets(run.scene)
    if run.body_position is not None:
        found["bodies"] = run.body_summary()
    if run.curvature is not None and run.bending_moment is not None:
        found["bending"] = bending_summary(run.scene, run.t, run.curvature, run.bending_moment)
    for key in ("accuracy", "error_tolerance", "refused_steps", "shortest_steps", "load_errors"):
        if key in run.settings:
            found[key] = run.settings[key]
    if run.failure:
        found["error"] = run.failure
    return jsonable(found)


def write_angles(solution: Samples, path: str | Path, zero: str = "horizontal") -> Path:
    """Polar angles and their rates: columns `t [s], theta_1..n [rad], omega_1..n [rad/s]`.

    For several lines the columns are `theta_LINE/1`, ..., line after line. The first comment also states the angle
    error of the run's time steps, `model_error=... [rad]`, if a companion has stated it (`run.companion`).

    Args:
        solution: the run.
        path: CSV file.
        zero: "horizontal" (positive downwards) or "down", see `link_angles`.
    """
    lines = [line.nodes for line in solution.lines]
    theta = np.concatenate([link_angles(solution.positions[:, nodes], zero)[0] for nodes in lines], axis=1)
    columns = {"theta": theta, "omega": solution.angle_rates(zero)[0]}
    errors = solution.settings.get("stated_errors") or {}
    error = errors.get("angles_rad") or 0.0
    stated = ""
    if 0.0 < error < 1.0:  # from 1 rad on the steps do not follow the motion
        stated = f", model_error={error:.2g}"
    return _write_links(solution, path, f"zero={zero}, sign=1, unit=rad{stated}", solution.t, columns)


def write_tensions(solution: Samples, path: str | Path) -> Path:
    """Tensions: columns `t [s], tension_1..n [N]` (`tension_LINE/1` for several lines); t is the time of the
    tension. A comment says which steps the rows are, if not all."""
    stated = "unit=N"
    if solution.saved_rows:
        stated = f"unit=N; {solution.saved_rows}"
    return _write_links(solution, path, stated, solution.t_tension, {"tension": solution.tension})


def write_bodies(solution: Samples, path: str | Path) -> Path:
    """Motion of rigid bodies: columns `t [s], x_BODY, y_BODY, z_BODY [m], roll_BODY, pitch_BODY, yaw_BODY [rad]`."""
    heads = []
    for body in solution.scene.bodies:
        heads += [f"{key}_{body.name}" for key in ("x", "y", "z", "roll", "pitch", "yaw")]
    both = np.concatenate([solution.body_position, solution.body_attitude], axis=-1)
    return _write(solution, path, "unit=m, rad", heads, [solution.t[:, None], both.reshape(len(both), -1)])


def _write_links(
    solution: Samples, path: str | Path, comment: str, t: np.ndarray, columns: dict[str, np.ndarray]
) -> Path:
    """Columns of the links: their numbers, with the name of the line if there are several lines."""
    names = []
    for line in solution.scene.lines:
        stem = f"{line.name}/" if len(solution.scene.lines) > 1 else ""
        names += [f"{stem}{j + 1}" for j in range(line.links)]
    heads = [f"{stem}_{name}" for stem in columns for name in names]
    return _write(solution, path, comment, heads, [t[:, None], *columns.values()])


def _write(solution: Samples, path: str | Path, comment: str, heads: list[str], columns: list[np.ndarray]) -> Path:
    """Columns (k, ...) with these heads after the time, under two comments; NaN is an empty cell."""
    scene = solution.scene
    text = io.StringIO()
    text.write(f"# {comment}\n# {scene.name}: {solution.settings.get('integrator')} with {scene.run.steps_in_words}\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["t", *heads])
    for row in np.concatenate(columns, axis=1).tolist():
        writer.writerow(["" if math.isnan(x) else repr(x) for x in row])
    return atomic_write(path, text.getvalue())
