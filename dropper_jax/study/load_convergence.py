"""Loads over the step: means, deviations and peaks of tensions at ever smaller steps."""

from __future__ import annotations

from typing import Any

from dropper_jax.base.progress import Progress, silent
from dropper_jax.load.scene import Scene
from dropper_jax.report.record import record
from dropper_jax.run.samples import finished
from dropper_jax.run.simulate import simulate
from dropper_jax.study.load_errors import line_loads

#: Largest relative error of each load that advice is given for.
WANTED = {"mean": 0.01, "deviation": 0.02, "window_maximum": 0.05, "maximum": 0.08}
#: Longest time simulated [s].
LONGEST = 60.0


def load_convergence(scene: Scene, dts: tuple[float, ...], skip: float = 0.0, say: Progress = silent) -> dict[str, Any]:
    """Errors of the loads of each line at steps `dts` [s], against half of the shortest, by the scene's own scheme.

    Returns:
        `rows`: {dt, status, us_per_step, errors: by load the largest relative error over the lines, or None};
        `reference_dt`, `loads` of the reference by line; `advice`: {load, within, dt, text}, dt the largest step from
        where all smaller ones are within, or None. Where the motion is chaotic, errors end at the chance between two
        runs and fall no further.
    """
    scene = scene.with_values({"run.duration": min(scene.run.duration, LONGEST)})
    steps = sorted(dts, reverse=True)
    reference_dt = 0.5 * steps[-1]
    say(0.0, f"loads, {reference_dt:.4g} s")
    finest = simulate(scene, dt=reference_dt)
    if not finished(finest):
        return {"rows": [], "reference_dt": reference_dt, "loads": [], "advice": [], "skipped": finest.failure}
    right = line_loads(record(finest, skip))
    rows = []
    for i, dt in enumerate(steps):
        say((i + 1) / (len(steps) + 1), f"loads, {dt:.4g} s")
        found = simulate(scene, dt=dt)
        good = finished(found) and len(found.t) > 3
        loads = line_loads(record(found, skip), right) if good else None
        errors = {name: None if loads is None else _worst(loads, right, name) for name in WANTED}
        rows.append({"dt": dt, "status": found.status, "us_per_step": found.us_per_step, "errors": errors})
    advice = [_advice(rows, name, within) for name, within in WANTED.items()]
    loads = [{"line": row["line"], "at_m": row["at_m"], **{name: row[name][0] for name in WANTED}} for row in right]
    return {"rows": rows, "reference_dt": reference_dt, "loads": loads, "advice": advice}


def _worst(loads: list[dict[str, Any]], right: list[dict[str, Any]], name: str) -> float:
    """Largest relative error over the lines; of a deviation relative to the mean where that is larger."""
    scale = [max(abs(row[name][0]), 1e-3 * abs(row["mean"][0]), 1e-300) for row in right]
    return max(abs(a[name][0] - b[name][0]) / s for a, b, s in zip(loads, right, scale, strict=True))


def _advice(rows: list[dict[str, Any]], name: str, within: float) -> dict[str, Any]:
    best = None
    for row in reversed(rows):  # from the shortest step up: one lucky step above a bad one does not count
        error = row["errors"][name]
        if error is None or error > within or row["status"] != "ok":
            break
        best = row["dt"]
    what = f"{name.replace('_', ' ')} within {within:.0%}"
    text = f"{what}: at no step tried" if best is None else f"{what}: steps of {best:.4g} s or less"
    return {"load": name, "within": within, "dt": best, "text": text}
