"""Bending moments and radii along each line."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.report.record import Record
from dropper_jax.run.bends import bending_moment, bending_summary, curvature


def line_bending(record: Record) -> list[dict[str, Any]]:
    """Per line the largest moment [N m], its place [m] and time [s], the smallest radius [m], and the largest and mean
    moment of each node [N m] over the length from the line's first point [m]."""
    scene = record.scene
    kappa = curvature(scene, record.positions)
    moment = bending_moment(scene, record.positions, record.t, tuple(record.solution.broken))
    summary = bending_summary(scene, record.t, kappa, moment)
    found = []
    for line, where in zip(scene.lines, record.lines, strict=True):
        own = moment[:, where.nodes]
        along = {"length_m": np.concatenate([[0.0], np.cumsum(line.length)]), "max_n_m": own.max(axis=0)}
        found.append({"line": line.name, **summary[line.name], **along, "mean_n_m": own.mean(axis=0)})
    return found
