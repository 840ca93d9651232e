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
    left = np.flatnonzero(windows.follows) - 1
    right = left + 1
    n, m2 = evaluation.start.shape[1] // 2, simulator.freedoms
    basis = chart(simulator.model_at(values), evaluation.start[right, :n])
    m = basis.shape[2]
    rows = np.zeros((len(left), m2, 2 * n))
    rows[:, :m, :n] = np.swapaxes(basis, 1, 2) / GAP_SCALE[0]
    rows[:, m:, n:] = np.swapaxes(basis, 1, 2) / GAP_SCALE[1]
    difference = evaluation.end[left] - evaluation.start[right]
    difference[:, :n] = np.asarray(wrap(difference[:, :n]))
    rows /= windows.gap_shares[:, None, None]
    end, start = rows @ evaluation.end_jacobian[left], rows @ evaluation.start_jacobian[right]
    return Gaps(
        left,
        np.einsum("gij,gj->gi", rows, difference),
        end[..., :m2],
        -start[..., :m2],
        end[..., m2:] - start[..., m2:],
    )


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
    gp = normal.gp + np.einsum("gij,gi->j", shared, value)
    return Joined(Normal(A, B, C, gz, gp), below)


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
