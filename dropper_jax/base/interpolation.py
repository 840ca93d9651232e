"""Linear interpolation of rows of numbers."""

from __future__ import annotations

import numpy as np


def interpolate_rows(positions: np.ndarray, rows: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Rows at other positions or times, linear between the given rows and constant outside them.

    At a given position the result is its row, even if a neighbouring row is not finite.

    Args:
        positions: increasing positions or times (k,) of the given rows; one is enough.
        rows: the given rows (k, ...).
        at: positions or times (q,).

    Returns:
        Rows (q, ...).
    """
    row = np.interp(at, positions, np.arange(len(positions)))
    below = row.astype(int)
    above = np.minimum(below + 1, len(positions) - 1)
    share = (row - below).reshape(-1, *[1] * (rows.ndim - 1))
    with np.errstate(invalid="ignore"):  # a failed run may end with infinite positions
        between = (1.0 - share) * rows[below] + share * rows[above]
    return np.where(share == 0.0, rows[below], between)
