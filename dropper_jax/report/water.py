"""Submergence: which nodes and buoys are under water, for how long and how deep."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.report.motion import node_arc
from dropper_jax.report.record import Record
from dropper_jax.scene import BuoySpec
from dropper_jax.scene.nodes import point_nodes


def submergence(record: Record, eta: np.ndarray) -> dict[str, Any]:
    """Per line, share of time under the actual surface and depth [m] of its nodes; per buoy the draught.

    Args:
        eta: elevation (k, nodes) [m] over every node.
    """
    depth = eta - record.positions[..., 2]
    lines = []
    for where in record.whole:
        spec = where.spec
        own = depth[:, where.nodes]
        lines.append(
            {
                "line": where.name,
                "arc_length_m": node_arc(spec.length),
                "share_under_water": (own > 0).mean(axis=0),
                "mean_depth_m": own.mean(axis=0),
                "least_depth_m": own.min(axis=0),
                "largest_depth_m": own.max(axis=0),
            }
        )
    return {"lines": lines, "buoys": [_buoy(record, buoy, depth) for buoy in record.scene.buoys]}


def _buoy(record: Record, buoy: BuoySpec, depth: np.ndarray) -> dict[str, Any]:
    base = depth[:, point_nodes(record.scene)[buoy.point]] + buoy.attachment
    return {
        "buoy": buoy.name,
        "draught_m": {"min": float(base.min()), "mean": float(base.mean()), "max": float(base.max())},
        "height_m": buoy.height,
        "share_under_water": float(np.mean(base >= buoy.height)),
        "share_out_of_water": float(np.mean(base <= 0)),
        "longest_under_water_s": _longest(base >= buoy.height, record.t),
    }


def _longest(under: np.ndarray, t: np.ndarray) -> float:
    """Longest uninterrupted time [s] between the samples where it is so."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], under, [False]]).astype(int)))
    return float(max((t[b - 1] - t[a] for a, b in zip(edges[::2], edges[1::2], strict=True)), default=0.0))
