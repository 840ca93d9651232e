"""Size of marks and width of lines of a run by the number of its samples, nodes and lines."""

from __future__ import annotations

import numpy as np

from dropper_jax.plots.run import Run

#: Number of samples below which they are marked: a line of one point is invisible.
FEW_SAMPLES = 5
#: Maximum number of nodes of systems of lines whose nodes have marks of full and of half size: more of them overlap.
FULL_MARKS = 40
HALF_MARKS = 200
#: Size of a full mark [points].
MARK_SIZE = 4.0
#: Maximum number of lines of a system that are drawn with `SEVERAL_WIDTH` of the usual width; more have `MANY_WIDTH`.
SEVERAL_LINES = 12
SEVERAL_WIDTH = 0.75
MANY_WIDTH = 0.4


def marker(t: np.ndarray) -> str | None:
    """Mark of the samples at times t (k,) [s]; None for many."""
    if len(t) < FEW_SAMPLES:
        return "o"
    return None


def dot(run: Run) -> float:
    """Size of a node's mark [points]: smaller where there are many."""
    nodes = run.positions.shape[1]
    if nodes <= FULL_MARKS or len(run.lines) == 1:
        return MARK_SIZE
    if nodes <= HALF_MARKS:
        return 0.5 * MARK_SIZE
    return 0.0


def bold(run: Run) -> float:
    """Fraction of the usual width of links, smaller for many lines."""
    if len(run.lines) == 1:
        return 1.0
    if len(run.lines) <= SEVERAL_LINES:
        return SEVERAL_WIDTH
    return MANY_WIDTH
