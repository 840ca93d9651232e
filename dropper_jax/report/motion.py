"""Displacement of points, acceleration of nodes, motion of bodies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dropper_jax.base.constants import DEGREE
from dropper_jax.base.numerics import spread
from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import Record
from dropper_jax.report.tables import Rows
from dropper_jax.scene import WholeLine


def watch_circles(record: Record) -> list[Table]:
    """Per moving point: horizontal radius [m] about its mean position and, after a static start, its static position.

    With the ranges of x, y, z [m]. Fixed points are left out.
    """
    found = []
    buoys = {buoy.point: buoy.name for buoy in record.scene.buoys}
    for point in record.scene.points:
        path = record.point(point.name)
        if not point.is_free and np.ptp(path, axis=0).max() == 0.0:
            continue
        mean = path.mean(axis=0)
        radius = _horizontal_distance(path, mean)
        static = None
        from_static = None
        if record.static_start:
            static = record.solution.point_path(point.name)[0]
            from_static = float(_horizontal_distance(path, static).max())
        found.append(
            {
                "point": point.name,
                "buoy": buoys.get(point.name),
                "mean_m": mean,
                "range_m": np.ptp(path, axis=0),
                "radius_max_m": float(radius.max()),
                "radius_95_m": float(np.percentile(radius, 95)),
                "static_m": static,
                "radius_from_static_max_m": from_static,
            }
        )
    return found


def _horizontal_distance(path: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Horizontal distance (k,) [m] of a path (k, 3) from a position (3,)."""
    return np.hypot(*(path - position)[:, :2].T)


def accelerations(record: Record) -> list[Table]:
    """Per line: root mean square, 99th percentile and maximum acceleration [m/s^2] of its nodes, and its location.

    Central differences of the saved velocities, which do not resolve periods below two saved intervals.
    """
    found = []
    for row, where in node_rows(record):
        own = record.acceleration[:, where.nodes]
        sample, node = np.unravel_index(np.argmax(own), own.shape)
        found.append(
            {
                **row,
                "rms_m_per_s2": np.sqrt(np.mean(own**2, axis=0)),
                "p99_m_per_s2": np.percentile(own, 99, axis=0),
                "max_m_per_s2": own.max(axis=0),
                "largest_m_per_s2": float(own[sample, node]),
                "at_m": float(row["arc_length_m"][node]),
                "t_s": float(record.t[sample]),
            }
        )
    return found


def node_rows(record: Record) -> Iterator[tuple[Table, WholeLine]]:
    """Per line: its name and the arc length [m] of its nodes, and where it is in the record."""
    for where in record.written_lines:
        yield {"line": where.name, "arc_length_m": node_arc(where.spec.length)}, where


def node_arc(lengths: np.ndarray) -> np.ndarray:
    """Unstretched arc length (n + 1,) [m] of a line's nodes."""
    return np.concatenate([[0.0], np.cumsum(lengths)])


#: Motions in the order of `body_position` and `body_attitude`.
MOVES = ("surge", "sway", "heave")
TURNS = ("roll", "pitch", "yaw")


def body_motions(record: Record) -> Rows:
    """Per rigid body: mean, standard deviation and extremes of its reference point [m] and of its attitude [deg].

    `tilt_deg` is the angle between the body's z-axis and the vertical.
    """
    run = record.solution
    if run.body_position is None or run.body_attitude is None or not record.scene.bodies:
        return {"skipped": "the scene has no rigid bodies"}
    is_evaluated = np.isin(run.t, record.t)
    found = []
    for i, body in enumerate(record.scene.bodies):
        turn = DEGREE * run.body_attitude[is_evaluated, i]
        # z of the body's z-axis for roll and pitch: cos(roll) cos(pitch)
        cosine = np.cos(run.body_attitude[is_evaluated, i, :2]).prod(axis=-1)
        tilt = DEGREE * np.arccos(np.clip(cosine, -1.0, 1.0))
        row: Table = {"body": body.name}
        for name, values in zip(MOVES, run.body_position[is_evaluated, i].T, strict=True):
            row[f"{name}_m"] = spread(values)
        for name, values in zip((*TURNS, "tilt"), (*turn.T, tilt), strict=True):
            row[f"{name}_deg"] = spread(values)
        found.append(row)
    return found
