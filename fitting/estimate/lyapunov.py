"""How fast a motion forgets where it started: the largest Lyapunov exponent along the windows of a trace."""

from __future__ import annotations

import numpy as np

from fitting.estimate.evaluation import Evaluation
from fitting.estimate.gaps import GAP_SCALE
from fitting.estimate.simulator import Simulator
from fitting.estimate.windows import Windows
from fitting.traces.planar import chart

#: Most growth exp(lambda T) of an error over a fit window, and over a held-out one, whose start must still be found.
FIT_GROWTH, HELD_GROWTH = 2.0, 6.0
#: Shortest and longest automatic window [s], the latter also as a part of the trace.
SHORTEST, LONGEST, LONGEST_PART = 0.25, 10.0, 0.125


def lyapunov(simulator: Simulator, windows: Windows, evaluation: Evaluation, values: np.ndarray) -> float:
    """Growth rate [1/s] of the fastest growing small error, by QR of the windows' transition matrices, chained."""
    n, m2 = evaluation.start.shape[1] // 2, simulator.freedoms
    basis = chart(simulator.model_at(values), evaluation.end[:, :n])
    m = m2 // 2
    scale = np.repeat(GAP_SCALE, m)
    turn = np.swapaxes(basis, 1, 2)
    move = np.concatenate(
        [turn @ evaluation.end_jacobian[:, :n, :m2], turn @ evaluation.end_jacobian[:, n:, :m2]], axis=1
    )
    move = move * scale[None, None, :] / scale[None, :, None]
    frame, total, time = np.eye(m2), 0.0, 0.0
    for k, matrix in enumerate(move):
        if windows.released[k]:  # has no start of its own to err in
            frame = np.eye(m2)
            continue
        if not np.isfinite(matrix).all():
            continue
        frame = np.eye(m2) if not windows.follows[k] else frame
        frame, upper = np.linalg.qr(matrix @ frame)
        total += float(np.log(max(abs(upper[0, 0]), 1e-300)))
        time += windows.length
    return total / time if time else 0.0


def first_window(freedoms: int, length: float, span: float) -> float:
    """Window [s] before anything is known: one second per 0.1 m link of a chain; long where chaos is impossible."""
    longest = max(SHORTEST, min(LONGEST, LONGEST_PART * span))
    if freedoms < 2:  # one angle cannot be chaotic
        return longest
    return min(longest, max(SHORTEST, float(np.sqrt(length / 0.1))))


def shorter_window(window: float, rate: float) -> float:
    """A window [s] over which errors grow by at most `FIT_GROWTH` e-folds; the present one where it is near that.

    Never a longer one: at start values with too much damping the motion looks tame.
    """
    return max(SHORTEST, FIT_GROWTH / rate) if rate * window > 2 * FIT_GROWTH else window
