"""What linear theory says of a twin, before any fit: Cramer and Rao's bound, and the error that a draw of noise makes.

With residuals (simulated - measured)/s, J = [Z P] at the truth and the window starts eliminated,

    P' = P - Z (Z'Z)^-1 Z'P,    covariance C = (P''P')^-1,    error of a fit to noise e: C P'' e + O(e^2)

so that fits of the same draws tell chance from bias: what is left after the linear error is the estimator's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.problem import Solution
from fitting.estimate.shooting import fit_shooting, joined_step
from fitting.estimate.windows import Windows, cut, first_starts
from fitting.traces.synthetic import Camera, observe


@dataclass(frozen=True)
class Linear:
    """Linear theory of the `windows` estimator on one twin.

    Attributes:
        slope: P' (rows, k) [1/parameter].
        covariance: C (k, k).
        windows: of the noise-free angles.
        own: error (k,) in standard errors that the simulator's step makes without noise.
        joined: covariance (k, k) of windows joined with next to no gap, one run that is never interrupted.
        found: the fit without noise, joined.
    """

    twin: Any
    noise: float
    slope: np.ndarray
    covariance: np.ndarray
    windows: Windows
    own: np.ndarray
    joined: np.ndarray
    found: Solution

    @property
    def joined_own(self) -> np.ndarray:
        """Error (k,) in standard errors of the fit without noise to joined windows: the steps of fit and truth."""
        return (self.found.values - self.twin.truth) / self.joined_std_error

    @property
    def joined_std_error(self) -> np.ndarray:
        """Cramer and Rao's bound (k,) of joined windows."""
        return np.sqrt(np.diag(self.joined))

    @property
    def std_error(self) -> np.ndarray:
        """Cramer and Rao's bound (k,)."""
        return np.sqrt(np.diag(self.covariance))

    def z(self, seed: int) -> np.ndarray:
        """Error over standard error (k,) that this draw of noise makes, to first order."""
        return self.covariance @ (self.slope.T @ self._draw(seed).ravel()) / self.std_error

    def joined_z(self, seed: int) -> np.ndarray:
        """The same (k,) for joined windows: what the draw adds to their step from the noise-free fit."""
        noisy, still = (self._joined_step(size * self._draw(seed)) for size in (1.0, 0.0))
        return (noisy - still) / self.joined_std_error

    def _draw(self, seed: int) -> np.ndarray:
        noisy = _windows(self.twin, self.noise, seed, self.windows.length, self.windows.dt)
        return (noisy.theta - self.windows.theta) * self.windows.weight

    def _joined_step(self, draw: np.ndarray) -> np.ndarray:
        free = np.full(len(self.own), np.inf)
        at = replace(self.found, evaluation=self.found.evaluation._replace(residual=-draw))
        return joined_step(at, -free, free).dp


def linearise(twin: Any, noise: float) -> Linear:
    """The theory of a twin of calibration.py with white noise [rad]."""
    prepared = twin.prepare(0)
    simulator, m2 = prepared.simulator, prepared.simulator.freedoms
    windows = _windows(twin, 0.0, 0, prepared.windows.length, prepared.windows.dt, weight=noise)
    clean = _trace(twin, 0.0, 0)
    guess = first_starts(simulator.model_at(twin.truth), [clean], windows, prepared.sigma)
    problem = replace(prepared.problem(frozen=np.ones(len(twin.truth), bool)), windows=windows)
    found = fit_windows(problem, twin.truth, guess)
    evaluation = found.evaluation
    jacobian = evaluation.jacobian.reshape(windows.count, -1, m2 + len(twin.truth))
    z, p = jacobian[..., :m2], jacobian[..., m2:]
    turn = np.swapaxes(z, 1, 2)
    slope = (p - z @ np.linalg.solve(turn @ z, turn @ p)).reshape(-1, len(twin.truth))
    covariance = np.linalg.inv(slope.T @ slope)
    own = -covariance @ (slope.T @ evaluation.residual.ravel()) / np.sqrt(np.diag(covariance))
    joined = fit_shooting(replace(found, problem=replace(problem, frozen=None)), continuity="tight")
    return Linear(twin, noise, slope, covariance, windows, own, np.linalg.inv(joined.information), joined)


def _trace(twin: Any, noise: float, seed: int) -> Any:
    trace = observe(twin.motion, Camera(angle_noise=noise), seed)
    return trace.in_model_convention(trace.convention)


def _windows(twin: Any, noise: float, seed: int, length: float, dt: float, weight: float | None = None) -> Windows:
    trace = _trace(twin, noise, seed)
    return cut([trace], length, dt, [np.full(trace.links, noise if weight is None else weight)])
