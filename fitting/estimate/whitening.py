"""Whitening: residuals and derivatives in units of independent noise, from white noise, AR(1) or jitter of frames.

A channel with AR(1) noise keeps `phi = exp(-decay dt)` of it from sample to sample; missing samples give a longer dt:

    u_i = (r_i - phi_i r_{i-1})/sqrt(1 - phi_i^2)

The first sample of a window is independent, u = r. If the window follows another one, its noise is correlated with the
previous sample, which belongs to another start. There `u = sqrt((1 - phi)/(1 + phi)) r`, the information of a sample on
slowly changing quantities. Windows in a row then carry no more information than the run that they were cut from.

A late frame moves every link along its rate. With b the links' rates times the standard deviation of the delay, over
their noise, the covariance of the frame is 1 + b b', and its inverse root

    u = r - (1 - 1/sqrt(1 + b'b)) b (b'r)/(b'b)

Both are linear: derivatives are whitened in the same way. Delays of standard deviation s also move the mean of an
angle, by half of s^2 times its acceleration, which is taken off the samples.
"""

from __future__ import annotations

import numpy as np

from fitting.estimate.normal_equations import Evaluation
from fitting.estimate.windows import Windows


def in_noise_units(evaluation: Evaluation, old: Windows, new: Windows) -> Evaluation:
    """An evaluation in units of the old samples' noise, in those of the new ones."""
    ratio = new.weight / np.where(old.weight > 0, old.weight, 1.0)
    residual = evaluation.residual * ratio
    jacobian = evaluation.jacobian * ratio[..., None]
    return evaluation._replace(residual=residual, jacobian=jacobian)


def whiten(windows: Windows, e: Evaluation) -> Evaluation:
    """The evaluation with residuals and derivatives of unit and independent noise."""
    if windows.decay is not None:
        before, phi, size = _memory(windows, windows.decay)
        previous = np.maximum(before, 0)
        residual = e.residual - phi * np.take_along_axis(e.residual, previous, 1)
        jacobian = e.jacobian - phi[..., None] * np.take_along_axis(e.jacobian, previous[..., None], 1)
        return e._replace(residual=size * residual, jacobian=size[..., None] * jacobian)
    if windows.jitter is not None:
        b, share = _late(windows, windows.jitter)
        residual = e.residual - share * b * np.sum(b * e.residual, axis=2, keepdims=True)
        turned = np.einsum("ksn,ksnj->ksj", b, e.jacobian)
        return e._replace(residual=residual, jacobian=e.jacobian - (share * b)[..., None] * turned[:, :, None])
    return e


def log_volume(windows: Windows) -> float:
    """Logarithm of the determinant of the noise's covariance, over all samples [log rad^2]."""
    known = windows.weight > 0
    total = -2 * np.sum(np.log(windows.weight[known]))
    if windows.decay is not None:
        total -= 2 * np.sum(np.log(_memory(windows, windows.decay)[2][known]))
    if windows.jitter is not None:
        total += np.sum(np.log1p(np.sum(_late(windows, windows.jitter)[0] ** 2, axis=2)))
    return total


def _memory(windows: Windows, decay: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For every sample (K, S, n): the previous sample of its channel (-1: none), phi, and the remaining size."""
    known = windows.weight > 0
    slots = np.arange(known.shape[1])[None, :, None]
    last = np.maximum.accumulate(np.where(known, slots, -1), axis=1)
    before = np.concatenate([np.full_like(last[:, :1], -1), last[:, :-1]], axis=1)
    t = np.broadcast_to(windows.times()[..., None], known.shape)
    apart = t - np.take_along_axis(t, np.maximum(before, 0), 1)
    decay = decay[:, None, :]
    first = before < 0
    phi = np.where(first, 0.0, np.exp(-decay * np.maximum(apart, 1e-300)))
    neighbours = (known[:, 1:] & known[:, :-1]).any(2)
    if neighbours.any():
        step = np.median(np.diff(windows.times(), axis=1)[neighbours])
    else:
        step = windows.dt
    usual = np.exp(-decay * step)
    continued = np.where(windows.follows[:, None, None], np.sqrt((1 - usual) / (1 + usual)), 1.0)
    size = np.where(first, continued, 1 / np.sqrt(np.maximum(1 - phi**2, 1e-12)))
    return before, np.where(known, phi, 0.0), np.where(known, size, 0.0)


def _late(windows: Windows, jitter: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """b (K, S, n) of every existing sample, and `(1 - 1/sqrt(1 + b'b))/(b'b)` of its frame (K, S, 1)."""
    b = np.where(windows.weight > 0, jitter, 0.0)
    square = np.sum(b**2, axis=2, keepdims=True)
    root = np.sqrt(1 + square)
    return b, 1 / (root * (1 + root))  # the same, without the division by b'b
