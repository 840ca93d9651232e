"""A run of another simulator as a row of `dropper_jax.study.work_precision.Comparison`."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from dropper_jax.model import Model
from dropper_jax.study.march import link_vectors, rms_angle, rms_position
from dropper_jax.study.reference import Reference


def time_runs(run: Callable[[], Any], repeats: int = 7) -> tuple[Any, float]:
    """Last result and minimum wall time [s] of `run`, which was called once before."""
    times = []
    result = None
    for _ in range(repeats):
        started = time.perf_counter()
        result = run()
        times.append(time.perf_counter() - started)
    return result, min(times)


def peer_row(
    model: Model, label: str, solver: str, r: np.ndarray, steps: int, wall: float, target: Reference, ok: bool
) -> dict[str, Any]:
    """A row from free-node positions (k, nodes, 3) at the reference's times."""
    ok = ok and bool(np.all(np.isfinite(r)))
    errors = (None, None)
    if ok:
        errors = rms_angle(link_vectors(model, r, target.t), target.links), rms_position(r, target.r)
    return {
        "integrator": label,
        "gamma": None,
        "solver": solver,
        "dtype": "float64",
        "label": label,
        "peer": True,
        "dt": target.horizon / max(steps, 1),
        "rms_angle_error_rad": errors[0],
        "rms_position_error_m": errors[1],
        "rms_tension_error_n": None,
        "energy_drift_j": None,
        "equivalent_linear_damping": None,
        "resolved": ok,
        "us_per_step": 1e6 * wall / max(steps, 1),
        "wall_s_per_simulated_s": wall / target.horizon,
        "status": "ok" if ok else "non_finite",
        "retried_steps": 0,
    }
