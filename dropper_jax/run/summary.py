"""The JSON object of a run."""

from __future__ import annotations

from typing import Any

from dropper_jax.base.json_values import SCHEMA, jsonable
from dropper_jax.integrators import OPTIONS
from dropper_jax.run.bends import bending_summary, bends
from dropper_jax.run.resolution import step_facts
from dropper_jax.run.samples import Samples
from dropper_jax.run.weights import line_weights
from dropper_jax.scene import line_offsets


def summary(run: Samples) -> dict[str, Any]:
    """The JSON object of a run; NaN and infinity are null."""
    keys = (
        "integrator",
        "solver",
        "dtype",
        "dt",
        "duration",
        "steps",
        *OPTIONS,
        "residual_tolerance",
        "save_every",
    )
    found = {
        "schema": SCHEMA,
        "status": run.status,
        "scene": run.scene.name,
        **{key: run.settings.get(key) for key in keys},
        **{
            key: run.settings[key]
            for key in ("step_tolerance", "error_tolerance", "refused_steps", "load_errors")
            if key in run.settings
        },
        "failed_steps": run.failed_steps,
        "retried_steps": run.retried_steps,
        "first_bad": run.first_bad,
        "max_residual": run.max_residual,
        "max_closure_error_m": run.max_closure_error,
        "energy_drift_j": run.energy_drift,
        "energy_scale_j": run.energy_scale,
        "work_j": dict(zip(run.work_names, run.work[-1], strict=True)),
        "max_speed_m_per_s": run.max_speed,
        "compile_s": run.compile_s,
        "run_s": run.run_s,
        "us_per_step": run.us_per_step,
        "realtime_factor": run.realtime_factor,
        **({"continued_from_s": run.t[0]} if run.continues else {}),
        "final_time_s": run.t[-1],
        "final_positions_m": run.positions[-1],
        "tension_n": run.tension_summary(),
        **({"tension_of_lines_n": run.line_tensions(), "lines": line_offsets(run.scene)} if run.scene.branched else {}),
        **({"bodies": run.body_summary()} if run.body_position is not None else {}),
        **(
            {"bending": bending_summary(run.scene, run.t, run.curvature, run.bending_moment)}
            if bends(run.scene)
            else {}
        ),
        "step_facts": step_facts(run),
        "end_forces_n": run.end_forces(),
        "line_weights": line_weights(run.scene),
        "link_mass_nodes": run.scene.link_mass_nodes,
        "broken": run.broken,
        "estimated_error": run.settings.get("estimated_error"),
        "step_check": run.settings.get("step_check"),
        "warnings": run.warnings,
        "versions": run.versions,
    }
    if run.failure:
        found["error"] = run.failure
    return jsonable(found)
