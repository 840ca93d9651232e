"""Convergence of the angles of each link: every step compared with half of it."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.model import Model, State
from dropper_jax.study.march import grid_run
from dropper_jax.study.schemes import Scheme, runnable

SCHEMES = (Scheme("energy_momentum"), Scheme("thesis_angles", 0.51))


def convergence(model: Model, s: State, grid: float, saves: int, dts: list[float]) -> list[Table]:
    """RMS difference of each link's angles [rad] between a step and half of it, over the first `saves * grid` seconds.

    Returns:
        one {label, dts, polar (steps, n), azimuth (steps, n) or None in a plane, status (steps,)} per scheme that
        runs the model; NaN if either run failed.
    """
    found = []
    everies = sorted({max(1, round(grid / dt)) for dt in dts})
    for scheme in runnable(SCHEMES, model)[0]:
        stepper = scheme.stepper(model)
        runs = [grid_run(stepper, model, s, grid, every, saves) for every in [*everies, 2 * everies[-1]]]
        changes = np.diff([run.angles for run in runs], axis=0)
        turns = np.angle(np.exp(1j * changes))  # modulo full turns
        polar, azimuth = np.sqrt(np.mean(turns**2, axis=2)).swapaxes(0, 1)
        if np.nanmax(azimuth, initial=0.0) < 1e-12:
            azimuth = None  # in a plane
        found.append(
            {
                "label": scheme.label,
                "dts": [grid / every for every in everies],
                "polar": polar,
                "azimuth": azimuth,
                "status": [run.status for run in runs[:-1]],
            }
        )
    return found
