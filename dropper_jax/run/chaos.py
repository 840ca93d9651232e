"""Chaos: from when on two runs of one scene with different steps are different motions."""

from __future__ import annotations

import numpy as np

from dropper_jax.run.row_store import Rows
from dropper_jax.run.samples import Samples

#: Travel as a fraction of the longest line below which nodes are at rest.
TRAVEL_AT_REST = 1e-3
#: Distance of the two runs, over the travel, up to which they are one motion ...
RESOLVED = 0.01
#: ... which they stay for at least this number of times the first swing ...
SWINGS = 3
#: ... and distance from which they are two motions ...
SEPARATED = 0.3
#: ... reached within this multiple of that time. A linear drift of the phase takes 30 times as long.
SUDDEN = 4.0


def time_of_divergence(solution: Samples, finer: Samples) -> float | None:
    """Time [s] from which a run and one with twice its saved states are different motions; None if they are not."""
    count = min(len(solution.t), (len(finer.t) + 1) // 2)
    nodes = solution.positions[1:count]
    if not len(nodes):  # the finer run has one saved state too, if `save_every` exceeds its steps
        return None
    travel = travel_of(solution, nodes)
    if travel is None:
        return None
    chaos = start_of_chaos(longest(finer.positions[2 : 2 * count : 2] - nodes) / travel, nodes)
    if chaos is None:
        return None
    return float(solution.t[1 + chaos])


def start_of_chaos(separation: np.ndarray, nodes: Rows) -> int | None:
    """Index of the saved time from which two runs are different motions; None if they are not.

    Small errors then grow at a rate that only chaos has.

    Args:
        separation: distance of the two runs over the travel (k,).
        nodes: positions of one run (k, nodes, 3) [m].
    """
    if not np.any(separation > SEPARATED):
        return None
    shift = longest(nodes - nodes[0])
    swing = int(np.argmax(shift > 0.5 * np.max(shift)))
    resolved = int(np.argmax(separation > RESOLVED))
    off = int(np.argmax(separation > SEPARATED))
    if resolved > SWINGS * swing and off < SUDDEN * resolved:
        return resolved
    return None


def travel_of(solution: Samples, nodes: Rows) -> float | None:
    """Maximum extent [m] of a node's path (k, nodes, 3); None for a run at rest."""
    travel = float(np.max(np.linalg.norm(np.ptp(nodes, axis=0), axis=1)))
    if travel > TRAVEL_AT_REST * max(line.total for line in solution.scene.lines):
        return travel
    return None


def longest(vectors: Rows) -> np.ndarray:
    """Length (k,) of the longest of vectors (k, nodes, 3)."""
    return np.sqrt(np.max(np.sum(vectors**2, axis=2), axis=1, initial=0.0))
