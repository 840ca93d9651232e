"""Growth of small errors in a motion, and windows that are as long as it allows.

Let M_k be the transition of window k, the derivative of its end by its start in units of a gap's scale. Errors grow
over windows j to k by at most the largest singular value of M_k ... M_j. The largest Lyapunov exponent is the mean
growth rate of the product of all. A whipping motion grows by far more than this mean at some moments. Windows are
therefore joined from short ones, up to the length that the growth of their own product allows.
"""

from __future__ import annotations

import numpy as np

from fitting.estimate.gaps import GAP_SCALE
from fitting.estimate.normal_equations import Evaluation
from fitting.estimate.simulator import Simulator
from fitting.estimate.windows import Piece, Windows
from fitting.traces.planar import chart

#: Maximum growth of an error over a fit window, in e-folds, and over a held-out one, whose start must still be found.
FIT_GROWTH, HELD_GROWTH = 2.0, 6.0
#: Shortest windows that are joined, as a fraction of the shortest link's period: links that whip at ten times the rate
#: of their own swing turn by less than one turn in it.
SHORTEST_PART = 0.2
#: Longest automatic window [s], and as a fraction of the trace.
LONGEST, LONGEST_PART = 10.0, 0.125


def transitions(simulator: Simulator, windows: Windows, evaluation: Evaluation, values: np.ndarray) -> np.ndarray:
    """Derivatives (K, m2, m2) of windows' ends by their starts, in units of a gap's scale; NaN if a run failed."""
    n, m2 = evaluation.start.shape[1] // 2, simulator.freedoms
    end = evaluation.end[:, :n]
    ran = np.isfinite(end).all(axis=1)  # a start from few samples, next to missing ones, may be infeasible
    turn = np.swapaxes(chart(simulator.model_at(values), np.where(ran[:, None], end, 0.0)), 1, 2)
    scale = np.repeat(GAP_SCALE, m2 // 2)
    move = np.concatenate(
        [turn @ evaluation.end_jacobian[:, :n, :m2], turn @ evaluation.end_jacobian[:, n:, :m2]], axis=1
    )
    return np.where(ran[:, None, None], move * scale[None, None, :] / scale[None, :, None], np.nan)


def lyapunov(simulator: Simulator, windows: Windows, evaluation: Evaluation, values: np.ndarray) -> float:
    """Growth rate [1/s] of the fastest growing small error, by QR of the windows' transition matrices, chained."""
    m2 = simulator.freedoms
    move = transitions(simulator, windows, evaluation, values)
    frame, total, time = np.eye(m2), 0.0, 0.0
    for k, matrix in enumerate(move):
        if windows.released[k]:  # has no start of its own, hence no error
            frame = np.eye(m2)
            continue
        if not np.isfinite(matrix).all():
            continue
        frame = np.eye(m2) if not windows.follows[k] else frame
        frame, upper = np.linalg.qr(matrix @ frame)
        total += float(np.log(max(abs(upper[0, 0]), 1e-300)))
        time += float(windows.lengths[k])
    return total / time if time else 0.0


def longest_window(freedoms: int, length: float, span: float, shortest: float) -> float:
    """Longest window [s]: one second per 0.1 m link of a chain; long where chaos is impossible."""
    longest = max(shortest, min(LONGEST, LONGEST_PART * span))
    if freedoms < 2:  # one angle cannot be chaotic
        return longest
    return min(longest, max(shortest, float(np.sqrt(length / 0.1))))


def follow_motion(windows: Windows, move: np.ndarray, steps: int) -> list[Piece]:
    """Windows joined from short ones while an error grows by at most `FIT_GROWTH` e-folds over them.

    Args:
        windows: short ones, each ending on a whole frame.
        move: their transitions (K, m2, m2).
        steps: maximum steps of a window.
    """
    found: list[Piece] = []
    product = np.eye(move.shape[1])
    for k, matrix in enumerate(move):
        piece = windows.piece(k)
        if windows.released[k]:  # its start comes from the model
            matrix = np.eye(len(matrix))
        further = matrix @ product if np.isfinite(matrix).all() else np.full_like(matrix, np.inf)
        grown = np.linalg.norm(further, 2) if np.isfinite(further).all() else np.inf
        last = found[-1] if found else None
        if last is not None and piece.follows and last.steps + piece.steps <= steps and grown <= np.exp(FIT_GROWTH):
            found[-1], product = last._replace(steps=last.steps + piece.steps), further
        else:
            found.append(piece)
            product = matrix if np.isfinite(matrix).all() else further
    return found
