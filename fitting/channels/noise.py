"""Noise of channels, estimated from the residuals: its size for each channel, and its correlation between samples.

With r residuals of a channel and X their derivatives, restricted maximum likelihood of white noise has a fixed point

    sigma^2 = sum r^2/(N - tr),      tr = trace of X (X' V^-1 X)^-1 X' V^-1 over the channel's samples.

Correlated noise, `phi = exp(-decay dt)`, is used if neighbours correlate and its innovations are white:

    u_i = (r_i - phi r_{i-1})/sqrt(1 - phi^2)

A misfit of the model differs from noise: no memory makes it white, and standard errors then come from blocks of scores.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from dropper_jax.model import State
from fitting.channels.channel import Data, Sensor
from fitting.estimate import noise as noise_model
from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.sandwich import hat_diagonal
from fitting.traces.trace import noise_by_differences


@dataclass(frozen=True)
class Noise:
    """Sizes (c,) [SI, or fractions of the value if relative] of the channels' noise, and its decay rates (c,) [1/s],
    infinite for white noise."""

    size: np.ndarray
    decay: np.ndarray

    def lag_correlation(self, interval: np.ndarray) -> np.ndarray:
        """Correlation of the noise of neighbouring samples (c,)."""
        return np.exp(-self.decay * interval)

    def max_relative_difference(self, other: Noise) -> float:
        """Maximum relative difference of two noises' sizes; infinite if only one has memory."""
        same = np.array_equal(np.isfinite(self.decay), np.isfinite(other.decay))
        return float(np.abs(np.log(self.size / other.size)).max()) if same else np.inf


@dataclass(frozen=True)
class Rows:
    """Residuals (N,) of unit and independent noise, their derivatives (N, p), channel, run and time of each."""

    residual: np.ndarray
    jacobian: np.ndarray
    channel: np.ndarray
    run: np.ndarray
    t: np.ndarray
    #: number of the column among all columns of all runs, and raw residuals in units of the noise, not whitened.
    column: np.ndarray
    raw: np.ndarray


class Evaluation(NamedTuple):
    """Predictions of every run and channel (k, m) [SI], and their derivatives by all parameters (k, m, p).

    `starts` are the runs' starts, from which the next ones are solved. `failed` describes a step that did not solve,
    or, if `unstable`, derivatives that overflow. `rows` are residuals in units of the noise, if that is known.
    """

    shown: tuple[tuple[np.ndarray, ...], ...]
    slopes: tuple[tuple[np.ndarray, ...], ...]
    starts: tuple[State, ...]
    failed: str = ""
    unstable: bool = False
    rows: Rows | None = None

    @property
    def residual(self) -> np.ndarray:
        """(1, N, 1), infinite if a run failed."""
        return np.full((1, 1, 1), np.inf) if self.rows is None else self.rows.residual[None, :, None]

    @property
    def jacobian(self) -> np.ndarray:
        """(1, N, 1, p)."""
        return self.rows.jacobian[None, :, None]


def first_noise(data: Data, floors: np.ndarray) -> Noise:
    """Noise of each channel from the data's file, otherwise from differences of high order."""
    sizes = [s.noise if s.noise is not None else _difference_noise(data, c) for c, s in enumerate(data.sensors)]
    return Noise(np.maximum(sizes, floors), np.full(len(sizes), np.inf))


def _difference_noise(data: Data, channel: int) -> float:
    """Standard deviation of white noise on a smooth motion, by differences of high order."""
    values = [run.values[channel] for run in data.runs]
    sizes = np.concatenate([noise_by_differences(y) for y in values])
    level = max(float(np.nanmax(np.abs(y))) for y in values)
    spread = max(float(np.nanstd(y, axis=0).max()) for y in values)
    found = float(np.nanmedian(sizes)) if np.isfinite(sizes).any() else 0.1 * spread
    return max(found, 1e-6 * level, 1e-12)


def scale_of(sensor: Sensor, shown: np.ndarray) -> np.ndarray:
    """Scale of a channel's noise at `shown`: 1, or the value if the noise is a fraction of it."""
    if not sensor.relative:
        return np.ones_like(shown)
    # a reading of 0 is not exact: at least 5 % of the channel's RMS
    return np.maximum(np.abs(shown), 0.05 * np.sqrt(np.mean(shown**2)))


def rows_of(data: Data, e: Evaluation, noise: Noise, scales: tuple[tuple[np.ndarray, ...], ...]) -> Rows:
    """All samples as rows of unit noise; correlation removed."""
    parts: list[tuple[np.ndarray, ...]] = []
    column = 0
    for number, run in enumerate(data.runs):
        for c, sensor in enumerate(data.sensors):
            residual = e.shown[number][c] - run.values[c]
            if sensor.channel.turns:
                residual = residual - 2 * np.pi * np.round(residual / (2 * np.pi))
            size = noise.size[c] * scales[number][c]
            for j in range(residual.shape[1]):
                known = np.isfinite(residual[:, j])
                t = run.t[c][known]
                r = (residual[:, j] / size[:, j])[known]
                x = (e.slopes[number][c][:, j] / size[:, j, None])[known]
                phi = np.exp(-noise.decay[c] * np.diff(t))
                of_channel, of_run, of_column = (np.full(len(t), value) for value in (c, number, column))
                white = noise_model.innovations(r, phi), noise_model.innovations(x, phi)
                parts.append((*white, of_channel, of_run, t, of_column, r))
                column += 1
    return Rows(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def lag_one(rows: Rows, channel: int, residual: np.ndarray) -> tuple[float, float]:
    """Correlation of neighbouring residuals of a channel, and its standard error for white noise."""
    mine = rows.channel == channel
    r, follows = residual[mine][None, :, None], (np.diff(rows.column[mine]) == 0)[None, :, None]
    return noise_model.lag_one(r, np.ones_like(r, bool), follows)


def _size_of(r: np.ndarray, loss: Loss) -> float:
    """Sum of squares of residuals, with a robust loss for outliers, consistent for normal residuals.

    With Student's loss, squares of slopes over `Loss.spread` do not determine the size, because the slope returns to
    zero: a smaller assumed size leaves a smaller sum. There, weight times square is used, which does not decrease.
    """
    if not loss.redescends:
        score = loss.weights(r) * r
        return float(score @ score) / loss.spread
    nodes, weights = np.polynomial.hermite_e.hermegauss(80)
    normal = float(weights @ (loss.weights(nodes) * nodes**2) / weights.sum())
    return float(loss.weights(r) @ r**2) / normal


def estimate_noise(
    data: Data,
    e: Evaluation,
    noise: Noise,
    scales: tuple[tuple[np.ndarray, ...], ...],
    information: np.ndarray,
    floors: np.ndarray,
    loss: Loss = LEAST_SQUARES,
) -> Noise:
    """The noise estimated from the residuals of a fit, starting from the noise used in the fit."""
    rows = rows_of(data, e, noise, scales)
    root = np.sqrt(loss.weights(rows.residual))
    used = np.bincount(rows.channel, hat_diagonal(root[:, None] * rows.jacobian, information))
    size, decay = noise.size.copy(), noise.decay.copy()
    for c in range(len(size)):
        mine = rows.channel == c
        rho, sure = lag_one(rows, c, rows.raw)
        decay[c] = np.inf
        r, left = rows.raw[mine], max(mine.sum() - used[c], 1.0)
        total = _size_of(r, loss)
        if noise_model.correlates(rho, sure):
            found = _memory(rows, c)
            if found is not None:
                decay[c], total = found
        size[c] = max(size[c] * np.sqrt(total / left), floors[c])
    return replace(noise, size=size, decay=decay)


def _memory(rows: Rows, channel: int) -> tuple[float, float] | None:
    """Memory [1/s] and sum of the squared innovations of a channel; None if the innovations are not white."""
    mine = rows.channel == channel
    r, t, column = rows.raw[mine], rows.t[mine], rows.column[mine]
    follows = column[1:] == column[:-1]
    apart = np.where(follows, np.diff(t), np.inf)

    def cost(log: float) -> float:
        phi = np.exp(-np.exp(log) * apart)
        return len(r) * np.log(np.mean(noise_model.innovations(r, phi) ** 2)) + float(np.sum(np.log(1 - phi**2)))

    interval = float(np.median(apart[follows]))
    ends = np.log(-np.log(0.995) / interval), np.log(-np.log(0.02) / interval)
    decay = float(np.exp(minimize_scalar(cost, bounds=ends, method="bounded").x))
    u = noise_model.innovations(r, np.exp(-decay * apart))
    left, _ = noise_model.lag_one(u[None, :, None], np.ones((1, len(u), 1), bool), follows[None, :, None])
    return (decay, float(u @ u)) if abs(left) < noise_model.WHITE else None
