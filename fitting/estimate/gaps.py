"""Gaps between consecutive windows, and the normal equations of windows joined by them.

    1/2 sum |r_k|^2 + 1/2 sum |N' (end_k - start_{k+1})/(w c_k s)|^2,   s = 0.1 rad and 1 rad/s

with c_k the root of the ratio of window k's length to the mean length, so that splitting a window does not allow more
process noise. Only neighbours are coupled: a block-tridiagonal matrix in the starts, bordered by the parameters.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fitting.estimate.normal_equations import Evaluation, Factor, Normal, Prior, Step, reduce_step
from fitting.estimate.simulator import Simulator
from fitting.estimate.windows import Windows
from fitting.traces.planar import chart, wrap

#: Sizes of a gap in angle [rad] and rate [rad/s] that weight 1 allows.
GAP_SCALE = (0.1, 1.0)


class Gaps(NamedTuple):
    """Gaps after windows `left` (g,) in the chart of the next: values (g, m2), derivatives by both windows' z and p."""

    left: np.ndarray
    value: np.ndarray
    before: np.ndarray
    after: np.ndarray
    shared: np.ndarray


def gaps(simulator: Simulator, windows: Windows, evaluation: Evaluation, values: np.ndarray) -> Gaps:
    """Scaled gaps between consecutive windows."""
    right = np.flatnonzero(windows.follows)
    left, n, m2 = right - 1, evaluation.start.shape[1] // 2, simulator.freedoms
    turn = np.swapaxes(chart(simulator.model_at(values), evaluation.start[right, :n]), 1, 2)
    rows = np.zeros((len(left), m2, 2 * n))
    rows[:, : m2 // 2, :n] = turn / GAP_SCALE[0]
    rows[:, m2 // 2 :, n:] = turn / GAP_SCALE[1]
    rows /= windows.gap_shares[:, None, None]
    difference = evaluation.end[left] - evaluation.start[right]
    difference[:, :n] = wrap(difference[:, :n])
    end, start = rows @ evaluation.end_jacobian[left], rows @ evaluation.start_jacobian[right]
    value = np.einsum("gij,gj->gi", rows, difference)
    return Gaps(left, value, end[..., :m2], -start[..., :m2], end[..., m2:] - start[..., m2:])


class Joined(NamedTuple):
    """Normal equations with gaps: diagonal and neighbouring blocks, border B, C, and slopes."""

    normal: Normal
    below: np.ndarray


def join(normal: Normal, g: Gaps, weight: float, offset: np.ndarray) -> Joined:
    """The normal equations with gaps of this weight, each shifted by its multiplier `offset` (g, m2)."""
    A, B, gz = normal.A.copy(), normal.B.copy(), normal.gz.copy()
    below = np.zeros((len(A) - 1, *A.shape[1:]))
    value, before, after, shared = ((x / weight) for x in (g.value + offset, g.before, g.after, g.shared))
    turn = lambda x: np.swapaxes(x, 1, 2)  # noqa: E731
    right = g.left + 1
    A[g.left] += turn(before) @ before
    A[right] += turn(after) @ after
    below[g.left] += turn(after) @ before
    B[g.left] += turn(before) @ shared
    B[right] += turn(after) @ shared
    gz[g.left] += np.einsum("gij,gi->gj", before, value)
    gz[right] += np.einsum("gij,gi->gj", after, value)
    C = normal.C + (turn(shared) @ shared).sum(0)
    return Joined(Normal(A, B, C, gz, normal.gp + np.einsum("gij,gi->j", shared, value)), below)


def eliminate_joined(system: Joined, damping: float, prior: Prior, low: np.ndarray, high: np.ndarray) -> Step:
    """One damped step with the starts of joined windows eliminated."""
    normal = system.normal
    diagonal = np.einsum("kii->ki", normal.A)
    A = normal.A + (damping * diagonal + 1e-13 * diagonal.max())[:, :, None] * np.eye(diagonal.shape[1])
    factor = Factor(A, system.below)
    solved = factor.solve(np.concatenate([normal.B, normal.gz[..., None]], axis=2))
    step, slope = reduce_step(normal, solved, damping, prior, low, high)
    # at the exact minimum of the damped model: decrease = -(slope)/2, plus the part withheld by the damping
    held = damping * (float(np.sum(diagonal * step.dz**2)) + float(np.diag(step.information) @ step.dp**2))
    return step._replace(predicted=-0.5 * slope + 0.5 * held, log_determinant=factor.log_determinant)


# Growth of small errors in a motion


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
    known = np.isfinite(move).all(axis=(1, 2))
    for k, matrix in enumerate(move):
        if windows.released[k] or (known[k] and not windows.follows[k]):
            frame = np.eye(m2)
        if known[k] and not windows.released[k]:  # a released one has no start of its own, hence no error
            frame, upper = np.linalg.qr(matrix @ frame)
            total += float(np.log(max(abs(upper[0, 0]), 1e-300)))
            time += float(windows.lengths[k])
    return total / time if time else 0.0
