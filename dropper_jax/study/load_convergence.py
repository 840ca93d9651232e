"""Loads of a scene over its accuracy or step: which of them give mean, deviation and maximum within their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropper_jax.base.progress import Progress, silent
from dropper_jax.base.read import Table
from dropper_jax.base.records import select_keys
from dropper_jax.evaluation.record import Record, record
from dropper_jax.load.scene import Scene
from dropper_jax.run.simulate import simulate
from dropper_jax.study.line_loads import LineLoads, has_loads, line_loads
from dropper_jax.study.work_precision import Each

#: Default accuracies of the runs for the loads.
LOAD_ACCURACIES = (0.1, 0.01, 1e-3, 1e-4)
#: Maximum relative error of each load for the advice.
ADVISED_ERRORS = {"mean": 0.01, "deviation": 0.02, "window_maximum": 0.05, "maximum": 0.08}
#: The reference over the finest run; errors of the second order: a quarter of the accuracy takes half of the step.
FINER = {"accuracy": 0.25, "dt": 0.5}
#: Fraction of a mean tension below which a load, such as the deviation of a constant tension, counts as this fraction.
SMALL_LOAD = 1e-3
#: Maximum duration of the comparison of loads [s].
LONGEST_LOADS = 60.0


def load_convergence(
    scene: Scene,
    key: str,
    values: Sequence[float],
    progress: Progress = silent,
    each: Each = lambda row: None,
) -> Table:
    """Errors of the loads of each line, relative to a run with half the finest step, by the scheme of the scene.

    Args:
        key, values: `accuracy` or `dt` [s] of the runs.
        each: gets each row as soon as the next finer one was run, with its errors relative to that.

    Returns:
        `rows`: {accuracy or None, dt, status, us_per_step, errors: by load the maximum relative error over the lines,
        or None}, dt the mean step of an accuracy; `reference_dt`, `loads` of the reference by line; `advice`: {load,
        within, accuracy, dt, text}: the coarsest row for which it and all finer ones are within the limit, or None. If
        the motion is chaotic, errors do not decrease below the random difference of two runs.
    """
    scene = scene.with_values({"run.duration": min(scene.run.duration, LONGEST_LOADS)})
    finest = FINER[key] * min(values)
    runs: list[_LoadRun] = []
    for i, value in enumerate([*sorted(values, reverse=True), finest]):
        progress(i / (len(values) + 1), f"loads, {key} {value:.4g}")
        runs.append(_LoadRun.of(scene, key, value))
        if i > 0:
            each(runs[-2].row(runs[-1].loads()))
    *coarser, finest_run = runs
    right = finest_run.loads()
    found: Table = {"rows": [], "reference_dt": finest_run.dt, "loads": [], "advice": []}
    if right is None:
        return found | {"skipped": finest_run.failure}
    found["rows"] = [run.row(right) for run in coarser]
    for name, within in ADVISED_ERRORS.items():
        found["advice"].append(_advice(found["rows"], name, within))
    for row in right:
        found["loads"].append({"line": row.line, "at_m": row.at_m, **select_keys(row.values, ADVISED_ERRORS)})
    return found


@dataclass(frozen=True)
class _LoadRun:
    """A run for its loads: its record, None if it failed or is too short; `dt` is the mean step of an accuracy."""

    accuracy: float | None
    dt: float
    status: str
    us_per_step: float
    failure: str
    record: Record | None

    @classmethod
    def of(cls, scene: Scene, key: str, value: float) -> _LoadRun:
        """The run with an accuracy or equal steps."""
        accuracy = value if key == "accuracy" else None
        step = value if key == "dt" else None
        solution = simulate(scene, accuracy=accuracy, dt=step)
        if solution.status == "interrupted":  # the part that `simulate` keeps has no loads to compare
            raise KeyboardInterrupt
        evaluated = None
        if has_loads(solution):
            evaluated = record(solution)
        dt = (solution.t[-1] - solution.t[0]) / max(solution.settings["steps"], 1)
        return cls(accuracy, dt, solution.status, solution.us_per_step, solution.failure, evaluated)

    def loads(self, right: list[LineLoads] | None = None) -> list[LineLoads] | None:
        """Loads of each line, at the positions of `right`."""
        if self.record is None:
            return None
        return line_loads(self.record, right)

    def row(self, right: list[LineLoads] | None) -> Table:
        """Its errors relative to the loads of a finer run."""
        errors: dict[str, float | None] = dict.fromkeys(ADVISED_ERRORS)
        loads = self.loads(right)
        if right is not None and loads is not None:
            errors = {name: _worst(loads, right, name) for name in ADVISED_ERRORS}
        return {
            "accuracy": self.accuracy,
            "dt": self.dt,
            "status": self.status,
            "us_per_step": self.us_per_step,
            "errors": errors,
        }


def _worst(loads: list[LineLoads], right: list[LineLoads], name: str) -> float:
    """Maximum relative error of a load over the lines; of one below `SMALL_LOAD` of the mean, relative to that."""
    errors = []
    for row, better in zip(loads, right, strict=True):
        value = better.values[name]
        scale = max(abs(value), SMALL_LOAD * abs(better.values["mean"]), np.finfo(float).tiny)
        errors.append(abs(row.values[name] - value) / scale)
    return max(errors)


def _advice(rows: list[Table], name: str, within: float) -> Table:
    """The coarsest row for which it and all finer ones have a load within this relative error."""
    best: Table = {"accuracy": None, "dt": None}
    for row in reversed(rows):  # from the finest upwards: an accurate run above an inaccurate one does not count
        error = row["errors"][name]
        if error is None or error > within or row["status"] != "ok":
            break
        best = row
    found = "not reached with the tested steps"
    if best["accuracy"] is not None:
        found = f"accuracy {best['accuracy']:.2g} or less"
    elif best["dt"] is not None:
        found = f"steps of {best['dt']:.4g} s or less"
    text = f"{name.replace('_', ' ')} within {within:.0%}: {found}"
    return {"load": name, "within": within, "accuracy": best["accuracy"], "dt": best["dt"], "text": text}
