"""Windows that are as long as the growth of small errors in the motion allows.

Let M_k be the transition of window k, the derivative of its end by its start in units of a gap's scale. Errors grow
over windows j to k by at most the largest singular value of M_k ... M_j. The largest Lyapunov exponent is the mean
growth rate of the product of all. A whipping motion grows by far more than this mean at some moments. Windows are
therefore joined from short ones, up to the length that the growth of their own product allows.
"""

from __future__ import annotations

import numpy as np

from fitting.estimate.windows import Piece, Windows

#: Maximum growth of an error over a fit window, in e-folds.
FIT_GROWTH = 2.0
#: Shortest windows that are joined, as a fraction of the shortest link's period: links that whip at ten times the rate
#: of their own swing turn by less than one turn in it.
SHORTEST_PART = 0.2
#: Longest automatic window [s], and as a fraction of the trace.
LONGEST = 10.0
LONGEST_PART = 0.125


def longest_window(freedoms: int, length: float, span: float, shortest: float) -> float:
    """Longest window [s]: one second per 0.1 m link of a chain; long where chaos is impossible."""
    chaotic = float(np.sqrt(length / 0.1)) if freedoms > 1 else np.inf  # one angle cannot be chaotic
    return max(shortest, min(LONGEST, LONGEST_PART * span, chaotic))


def follow_motion(windows: Windows, move: np.ndarray, steps: int) -> list[Piece]:
    """Windows joined from short ones while an error grows by at most `FIT_GROWTH` e-folds over them.

    Args:
        windows: short ones, each ending on a whole frame.
        move: their transitions (K, m2, m2).
        steps: maximum steps of a window.
    """
    found: list[Piece] = []
    one = np.eye(move.shape[1])
    move = np.where(windows.released[:, None, None], one, move)  # the start of a released window comes from the model
    product = one
    for k, matrix in enumerate(move):
        piece = windows.piece(k)
        further = matrix @ product
        total = piece.steps + sum(last.steps for last in found[-1:])
        if np.isfinite(further).all():
            grown = np.linalg.norm(further, 2)
        else:
            grown = np.inf
        if found and piece.follows and total <= steps and grown <= np.exp(FIT_GROWTH):
            found[-1], product = found[-1]._replace(steps=total), further
        else:
            found.append(piece)
            product = matrix
    return found
