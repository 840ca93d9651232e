"""Seabed contact: how much of each line lies on the bed, and for how long."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.report.motion import node_arc
from dropper_jax.report.record import Record
from dropper_jax.report.settings import Settings


def bed_contact(record: Record, bed: np.ndarray, settings: Settings) -> list[dict[str, Any]]:
    """Per line: length on the bed [m] over time and share of time of each node.

    A node lies on the bed where it is at most `contact` above it, a link where both its ends do: the length is whole
    links, so that a line that rises from an anchor on the bed has none.

    Args:
        bed: height (k, nodes) [m] of the bed under every node.
    """
    on = record.positions[..., 2] - bed <= settings.contact
    found = []
    for where in record.whole:
        spec = where.spec
        own = on[:, where.nodes]
        length = (own[:, :-1] & own[:, 1:]) @ np.asarray(spec.length, float)
        found.append(
            {
                "line": where.name,
                "arc_length_m": node_arc(spec.length),
                "length_m": {"min": float(length.min()), "mean": float(length.mean()), "max": float(length.max())},
                "share_of_line": float(length.mean() / spec.total),
                "share_of_time": own.mean(axis=0),
                "share_with_contact": float(np.mean(length > 0)),
            }
        )
    return found
