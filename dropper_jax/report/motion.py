"""Displacement of points and acceleration of nodes."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.report.record import Record


def watch_circles(record: Record) -> list[dict[str, Any]]:
    """Per moving point: horizontal radius [m] about its mean position and, after a static start, its static position.

    With the ranges of x, y, z [m]. Fixed points are left out.
    """
    found = []
    buoys = {buoy.point: buoy.name for buoy in record.scene.buoys}
    for point in record.scene.points:
        path = record.point(point.name)
        if point.kind == "fixed" and np.ptp(path, axis=0).max() == 0.0:
            continue
        mean = path.mean(axis=0)
        about = np.hypot(*(path - mean)[:, :2].T)
        static = record.solution.point_path(point.name)[0] if record.static_start else None
        found.append(
            {
                "point": point.name,
                "buoy": buoys.get(point.name),
                "mean_m": mean,
                "range_m": np.ptp(path, axis=0),
                "radius_max_m": float(about.max()),
                "radius_95_m": float(np.percentile(about, 95)),
                "static_m": static,
                "radius_from_static_max_m": None
                if static is None
                else float(np.hypot(*(path - static)[:, :2].T).max()),
            }
        )
    return found


def accelerations(record: Record) -> list[dict[str, Any]]:
    """Per line: root mean square, 99th percentile and maximum acceleration [m/s^2] of its nodes, and its location.

    Central differences of the saved velocities, which do not resolve periods below two saved intervals.
    """
    change = np.gradient(record.velocities, record.t, axis=0)
    size = np.linalg.norm(change, axis=-1)
    found = []
    for where in record.written_lines:
        spec = where.spec
        own = size[:, where.nodes]
        high = np.unravel_index(np.argmax(own), own.shape)
        found.append(
            {
                "line": where.name,
                "arc_length_m": node_arc(spec.length),
                "rms_m_per_s2": np.sqrt(np.mean(own**2, axis=0)),
                "p99_m_per_s2": np.percentile(own, 99, axis=0),
                "max_m_per_s2": own.max(axis=0),
                "largest_m_per_s2": float(own[high]),
                "at_m": float(node_arc(spec.length)[high[1]]),
                "t_s": float(record.t[high[0]]),
            }
        )
    return found


def node_arc(lengths: np.ndarray) -> np.ndarray:
    """Unstretched arc length (n + 1,) [m] of a line's nodes."""
    return np.concatenate([[0.0], np.cumsum(lengths)])
