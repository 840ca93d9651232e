"""Residuals of correlated noise made white: channels that remember, frames whose links share a delay.

A channel that keeps `phi = exp(-decay dt)` of its noise from sample to sample (AR(1)), missing samples being longer dt:

    u_i = (r_i - phi_i r_{i-1})/sqrt(1 - phi_i^2)

The first sample of a window stands for itself, u = r. Where the window follows another one its noise is that of the
sample before, which belongs to another start: there `u = sqrt((1 - phi)/(1 + phi)) r`, as much as a sample tells of
what changes slowly, so that windows in a row tell no more than the run that they were cut from.

A frame that is taken late moves every link along its rate. With b the links' rates times the deviation of the delay,
over their noise, the covariance of the frame is 1 + b b', and its inverse root

    u = r - (1 - 1/sqrt(1 + b'b)) b (b'r)/(b'b)

Both are linear: derivatives are made white in the same way.
"""

from __future__ import annotations

import numpy as np

from fitting.estimate.evaluation import Evaluation
from fitting.estimate.windows import Windows


def whitened(windows: Windows, e: Evaluation) -> Evaluation:
    """The evaluation with residuals and derivatives of unit and independent noise."""
    if windows.decay is not None:
        before, phi, size = _memory(windows)
        pick = np.maximum(before, 0)
        shift = lambda a, more: np.take_along_axis(a, pick.reshape(*pick.shape, *more), 1)  # noqa: E731
        residual = size * (e.residual - phi * shift(e.residual, ()))
        jacobian = size[..., None] * (e.jacobian - phi[..., None] * shift(e.jacobian, (1,)))
        return e._replace(residual=residual, jacobian=jacobian)
    if windows.jitter is not None:
        b, share = _late(windows)
        along = np.sum(b * e.residual, axis=2, keepdims=True)
        turned = np.einsum("ksn,ksnj->ksj", b, e.jacobian)
        residual = e.residual - share * b * along
        jacobian = e.jacobian - (share * b)[..., None] * turned[:, :, None]
        return e._replace(residual=residual, jacobian=jacobian)
    return e


def log_volume(windows: Windows) -> float:
    """Logarithm of the determinant of the noise's covariance, over all samples [log rad^2]."""
    known = windows.weight > 0
    total = -2 * float(np.sum(np.log(windows.weight[known])))
    if windows.decay is not None:
        total -= 2 * float(np.sum(np.log(_memory(windows)[2][known])))
    if windows.jitter is not None:
        b, _ = _late(windows)
        total += float(np.sum(np.log1p(np.sum(b**2, axis=2))))
    return total


def _memory(windows: Windows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of every sample (K, S, n): which one of its channel comes before (-1: none), phi, and the size that is left."""
    known = windows.weight > 0
    slots = np.arange(known.shape[1])[None, :, None]
    last = np.maximum.accumulate(np.where(known, slots, -1), axis=1)
    before = np.concatenate([np.full_like(last[:, :1], -1), last[:, :-1]], axis=1)
    t = np.broadcast_to(windows.times()[..., None], known.shape)
    apart = t - np.take_along_axis(t, np.maximum(before, 0), 1)
    decay = windows.decay[:, None, :]
    first = before < 0
    phi = np.where(first, 0.0, np.exp(-decay * np.maximum(apart, 0.0)))
    step = np.median(np.diff(windows.times(), axis=1)[known.all(2)[:, 1:]]) if known.all(2)[:, 1:].any() else windows.dt
    kept = np.exp(-decay * step)
    continued = np.where(windows.follows[:, None, None], np.sqrt((1 - kept) / (1 + kept)), 1.0)
    size = np.where(first, continued, 1 / np.sqrt(np.maximum(1 - phi**2, 1e-12)))
    return before, np.where(known, phi, 0.0), np.where(known, size, 0.0)


def _late(windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """b (K, S, n) of every sample that is there, and `(1 - 1/sqrt(1 + b'b))/(b'b)` of its frame (K, S, 1)."""
    b = np.where(windows.weight > 0, windows.jitter, 0.0)
    square = np.sum(b**2, axis=2, keepdims=True)
    root = np.sqrt(1 + square)
    return b, 1 / (root * (1 + root))  # the same, without the division by b'b
