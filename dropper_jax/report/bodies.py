"""Motion of the rigid bodies of a run."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.base.constants import DEGREE
from dropper_jax.report.record import Record
from dropper_jax.report.sections import table

#: Motions in the order of `body_position` and `body_attitude`.
MOVES, TURNS = ("surge", "sway", "heave"), ("roll", "pitch", "yaw")


def body_motions(record: Record) -> list[dict[str, Any]] | dict[str, str]:
    """Per rigid body: mean, standard deviation and extremes of its reference point [m] and of its attitude [deg].

    `tilt_deg` is the angle between the body's z-axis and the vertical.
    """
    run = record.solution
    if run.body_position is None or not record.scene.bodies:
        return {"skipped": "the scene has no rigid bodies"}
    kept = np.isin(run.t, record.t)
    found = []
    for i, body in enumerate(record.scene.bodies):
        position, turn = run.body_position[kept, i], run.body_attitude[kept, i]
        tilt = np.arccos(np.clip(np.cos(turn[:, 0]) * np.cos(turn[:, 1]), -1.0, 1.0))
        row: dict[str, Any] = {"body": body.name}
        row |= {f"{name}_m": _spread(position[:, j]) for j, name in enumerate(MOVES)}
        row |= {f"{name}_deg": _spread(DEGREE * turn[:, j]) for j, name in enumerate(TURNS)}
        found.append({**row, "tilt_deg": _spread(DEGREE * tilt)})
    return found


def bodies_text(found: list[dict[str, Any]] | dict[str, str]) -> list[str]:
    """The section as text; empty without bodies."""
    if not isinstance(found, list):
        return []
    rows = []
    for body in found:
        for key in (*(f"{name}_m" for name in MOVES), *(f"{name}_deg" for name in TURNS), "tilt_deg"):
            name, _, unit = key.partition("_")
            cells = (f"{0.0 if abs(body[key][k]) < 5e-4 else body[key][k]:.3f}" for k in ("mean", "std", "min", "max"))
            rows.append([body["body"], f"{name} [{unit}]", *cells])
    return ["## Bodies", table(["body", "motion", "mean", "deviation", "least", "largest"], rows)]


def _spread(values: np.ndarray) -> dict[str, float]:
    return {
        "mean": float(values.mean()),
        "std": float(values.std()),
        "min": float(values.min()),
        "max": float(values.max()),
    }
