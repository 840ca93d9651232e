"""Growth of small errors in a motion, and windows that are as long as it allows.

Let M_k be the transition of window k, the derivative of its end by its start in units of a gap's scale. Errors grow
over windows j to k by at most the largest singular value of M_k ... M_j. The largest Lyapunov exponent is the mean
growth rate of the product of all. A whipping motion grows by far more than this mean at some moments. Windows are
therefore joined from short ones, up to the length that the growth of their own product allows.
"""

from __future__ import annotations

import numpy as np

from fitting.estimate.normal_equations import Evaluation
from fitting.estimate.simulator import Simulator
from fitting.estimate.window_problem import GAP_SCALE
from fitting.estimate.windows import Piece, Windows
from fitting.traces.planar import chart


def transitions(simulator: Simulator, evaluation: Evaluation, values: np.ndarray) -> np.ndarray:
    """Derivatives (K, m2, m2) of windows' ends by their starts, in units of a gap's scale; NaN if a run failed."""
    n = evaluation.start.shape[1] // 2
    m2 = simulator.freedoms
    end = evaluation.end[:, :n]
    ran = np.all(np.isfinite(end), axis=1)  # a start from few samples, next to missing ones, may be infeasible
    turn = chart(simulator.model_at(values), np.where(ran[:, None], end, 0.0)).mT
    scale = np.repeat(GAP_SCALE, m2 // 2)
    angles, rates = np.split(evaluation.end_jacobian[..., :m2], 2, axis=1)
    move = np.concatenate([turn @ angles, turn @ rates], axis=1)
    return np.where(ran[:, None, None], move * scale / scale[:, None], np.nan)


def lyapunov(windows: Windows, move: np.ndarray) -> float:
    """Growth rate [1/s] of the fastest growing small error, by QR of the windows' transitions (K, m2, m2), chained."""
    one = np.eye(move.shape[1])
    frame = one
    total = 0.0
    time = 0.0
    known = np.all(np.isfinite(move), axis=(1, 2))
    for k, matrix in enumerate(move):
        if windows.released[k] or (known[k] and not windows.follows[k]):
            frame = one
        if known[k] and not windows.released[k]:  # a released one has no start of its own, hence no error
            frame, upper = np.linalg.qr(matrix @ frame)
            total += np.log(max(abs(upper[0, 0]), 1e-300))
            time += windows.lengths[k]
    if time:
        return total / time
    return 0.0


#: Maximum growth of an error over a fit window, in e-folds.
FIT_GROWTH = 2.0


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
    for piece, matrix in zip(windows.pieces(), move, strict=True):
        further = matrix @ product
        grows = not np.isfinite(further).all() or np.linalg.norm(further, 2) > np.exp(FIT_GROWTH)
        if found and piece.follows and not grows and found[-1].steps + piece.steps <= steps:
            found[-1] = found[-1]._replace(steps=found[-1].steps + piece.steps)
            product = further
        else:
            found.append(piece)
            product = matrix
    return found
